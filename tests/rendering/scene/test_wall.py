"""What the camera sees of the wall's paint: its albedo, texture and gain of each channel."""

from dataclasses import replace

import numpy as np
import pytest

from periscopy_sim.analytic.point_light import point_light_backgrounds
from periscopy_sim.errors import SceneError
from periscopy_sim.model.observation import observation_of
from periscopy_sim.rendering.scene.load import build_scene, camera_of


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


def test_grey_texture_is_in_the_rows_and_the_colour_in_the_gain(room):
    seen = room.load(wall=room.wall(checkered("0.6, 0.3, 0.3", "0.2, 0.1, 0.1", 5)))
    grey = seen.wall_texture
    assert grey.shape == (30,) and grey.mean() == pytest.approx(1) and np.ptp(grey) > 0.2
    np.testing.assert_allclose(seen.channel_gain, [1.5, 0.75, 0.75], rtol=1e-4)
    scale = seen.wall_reflectance[0, 0] / grey[0]
    np.testing.assert_allclose(
        seen.wall_reflectance, scale * np.outer(grey, [1, 0.5, 0.5]), rtol=1e-4
    )
    without = point_light_backgrounds(replace(seen, wall_texture=None))
    np.testing.assert_allclose(point_light_backgrounds(seen), without * grey[:, None])


def test_pixels_that_lack_a_colour_are_left_out(room):
    seen = room.load(wall=room.wall(checkered("0.6, 0.3, 0.3", "0.5, 0.3, 0.01", 3)))
    dark = (seen.channel_gain == 0).all(axis=1)
    assert 0 < dark.sum() < 30
    observation = observation_of(np.ones((30, 6)), (2, 3), seen.channel_gain)
    np.testing.assert_array_equal(observation.mask, ~dark)
    with pytest.raises(SceneError, match="hardly reflects one of the three colours"):
        room.load(wall=room.wall(checkered("0.6, 0.3, 0", "0.1, 0.3, 0", 40)))


@pytest.mark.filterwarnings("ignore:scene .* such fine detail:RuntimeWarning")
@pytest.mark.parametrize("squares", [7, 40, 150])
def test_texture_is_averaged_over_each_pixel(room, squares):
    import mitsuba as mi

    seen = room.load(wall=room.wall(checkered("0.9, 0.8, 0.2", "0.3, 0.2, 0.4", squares)))
    scene = build_scene(seen, np.zeros((2, 3, 3)))
    albedo = mi.load_dict({"type": "aov", "aovs": "wall:albedo"})
    seen_by_mitsuba = mi.render(scene, sensor=camera_of(scene), integrator=albedo, spp=1 << 14)
    expected = np.array(seen_by_mitsuba, dtype=np.float64).reshape(-1, 3)
    found = seen.wall_reflectance
    error = np.sqrt(np.mean((found - expected) ** 2) / np.mean(expected**2))
    assert error < 0.005


def test_texture_as_fine_as_noise_is_told(room, tmp_path):
    import mitsuba as mi

    noise = np.random.default_rng(0).integers(0, 2, (2048, 2048, 1)).astype(np.uint8) * 255
    mi.util.write_bitmap(str(tmp_path / "noise.png"), noise, write_async=False)
    paper = (
        '<bsdf type="diffuse"><texture type="bitmap" name="reflectance"><string name="filename" '
        f'value="{tmp_path / "noise.png"}"/><string name="filter_type" value="nearest"/>'
        "</texture></bsdf>"
    )
    with pytest.warns(RuntimeWarning, match="such fine detail that its mean over a pixel is known"):
        seen = room.load(wall=room.wall(paper))
    assert 0.01 < np.std(seen.wall_texture) < 0.2
