import numpy as np
import pytest

from periscopy_sim.errors import SceneError
from tests.scenes.materials import (
    BLEND,
    BUMPS,
    RAMP,
    SLOPE,
    write_files,
    write_heights,
    write_slope,
)


def test_color_of_the_wall_is_split_into_albedo_and_gain(room):
    paint = '<bsdf type="diffuse"><rgb name="reflectance" value="0.6, 0.3, 0.15"/></bsdf>'
    seen = room.load(wall=room.wall(paint))
    np.testing.assert_allclose(seen.view.reflectance, [0.6, 0.3, 0.15], rtol=1e-5)
    np.testing.assert_allclose(seen.channel_gain, np.array([0.6, 0.3, 0.15]) / 0.35, rtol=1e-5)


BY_BOTH = {"type": "direct"}
"""By the emitter and by the BSDF: a tenth of the noise by the BSDF alone."""

WALLS = {
    "roughplastic": '<bsdf type="roughplastic"/>',
    "principled": '<bsdf type="principled"/>',
    "mask": '<bsdf type="mask"><float name="opacity" value="1"/><bsdf type="diffuse"/></bsdf>',
    "blendbsdf": BLEND,
    "bumpmap": RAMP,
    "normalmap": SLOPE,
}


@pytest.mark.thorough
@pytest.mark.parametrize("kind", WALLS)
def test_wall_that_is_rough_is_right(room, is_right, kind):
    write_files(room.folder)
    is_right(wall=room.wall(WALLS[kind]), truth=BY_BOTH)


def test_wall_of_uneven_bumps_is_refused(room):
    write_heights(room.folder)
    with pytest.raises(SceneError, match=r"\(bumpmap\) reflects differently"):
        room.load(wall=room.wall(BUMPS))


@pytest.mark.parametrize("normal", [(0.3, 0, 0.954), (0, 0.3, 0.954)])
def test_diffuse_wall_beneath_a_normal_map_has_no_closed_form(room, normal):
    write_slope(room.folder, normal)
    seen = room.load(wall=room.wall(SLOPE))
    assert seen.view.reflectance is None


def test_normals_that_a_mesh_brings_are_the_walls(room, is_right):
    corners = [(-0.3, -0.7), (1.7, -0.7), (1.7, 1.3), (-0.3, 1.3)]
    rows = "\n".join(f"{x} 1 {z} 0.6 -0.8 0" for x, z in corners)
    (room.folder / "wall.ply").write_text(
        "ply\nformat ascii 1.0\nelement vertex 4\n"
        + "".join(f"property float {name}\n" for name in ("x", "y", "z", "nx", "ny", "nz"))
        + "element face 2\nproperty list uchar int vertex_indices\nend_header\n"
        + rows
        + "\n3 0 1 2\n3 0 2 3\n"
    )
    wall = (
        '<shape type="ply" id="wall"><string name="filename" value="wall.ply"/>'
        f"{room.diffuse}</shape>"
    )
    seen = room.load(wall=wall)
    np.testing.assert_allclose(
        seen.view.center_normals, np.tile([0.6, -0.8, 0], (30, 1)), atol=1e-6
    )
    is_right(wall=wall)
