"""What the camera sees of the wall's paint: its albedo and gain of each channel."""

import numpy as np
import pytest

from periscopy_sim.errors import SceneError


def checkered(first, second, squares):
    return (
        '<bsdf type="diffuse"><texture type="checkerboard" name="reflectance">'
        f'<rgb name="color0" value="{first}"/><rgb name="color1" value="{second}"/>'
        f'<transform name="to_uv"><scale value="{squares}"/></transform></texture></bsdf>'
    )


def test_color_of_the_wall_is_split_into_albedo_and_gain(room):
    paint = '<bsdf type="diffuse"><rgb name="reflectance" value="0.6, 0.3, 0.15"/></bsdf>'
    seen = room.load(wall=room.wall(paint))
    np.testing.assert_allclose(seen.wall_reflectance, [0.6, 0.3, 0.15], rtol=1e-5)
    np.testing.assert_allclose(seen.channel_gain, np.array([0.6, 0.3, 0.15]) / 0.35, rtol=1e-5)


def test_wall_of_a_texture_however_fine_is_refused(room):
    for squares in (3, 40, 150):
        with pytest.raises(SceneError, match="from place to place"):
            room.load(wall=room.wall(checkered("0.9, 0.8, 0.2", "0.3, 0.2, 0.4", squares)))
