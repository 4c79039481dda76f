import numpy as np
import pytest

from periscopy_sim.analytic.area_transport import area_transport
from periscopy_sim.analytic.point_light import point_light_backgrounds
from periscopy_sim.errors import SceneError
from periscopy_sim.rendering import ambient, load
from periscopy_sim.rendering.ambient import render_background
from periscopy_sim.rendering.bounced import render_bounced_light
from periscopy_sim.rendering.shadow_rays import render_transport
from periscopy_sim.rendering.variant import mi
from periscopy_sim.scenario import Scenario, load_scenario
from tests.scenes.materials import (
    BLEND,
    BUMPS,
    RAMP,
    SLOPE,
    bitmap,
    checkered,
    diffuse,
    write_files,
    write_heights,
    write_slope,
)

TILES = checkered("0.8, 0.8, 0.3", "0.2, 0.1, 0.3", 9)


def pictures_of(path, *, seeds=4):
    """Photographs of a file by Mitsuba alone, of one bounce."""
    scene = mi.load_file(str(path))
    traced = mi.load_dict({"type": "path", "max_depth": 2})
    return np.array(
        [np.array(mi.render(scene, integrator=traced, spp=1 << 14, seed=k)) for k in range(seeds)]
    )


def error(found, pictures):
    """Root mean square over the mean, what the pictures' own noise makes of it taken off."""
    mean = pictures.mean(axis=0).reshape(-1, 3)
    noise = pictures.var(axis=0, ddof=1).mean() / len(pictures)
    return np.sqrt(max(np.mean((found - mean) ** 2) - noise, 0)) / mean.mean()


@pytest.mark.parametrize("texture", [TILES, checkered("0.8, 0.7, 0.3", "0.2, 0.1, 0.3", 150)])
def test_a_times_the_pixels_colour_is_the_photograph_of_a_textured_wall(room, texture):
    board = room.cube((0.45, 0.5, 0.3), (0.05, 0.01, 0.05))
    parts = {"wall": room.wall(diffuse(texture)), "monitor": room.monitor(room.area)}
    pictures = pictures_of(room.write(board, **parts))
    seen, white = room.load(board, **parts).averaged(6), np.ones((6, 3))
    # One albedo of each point for three channels: in pixels of 7 cm an error of half a percent.
    for A in (area_transport(seen), render_transport(seen, samples=16, seed=1)):
        assert error(seen.channel_gain * (A @ white), pictures) < 1e-2
    channels = [Scenario(seen.view.of_channel(c), seen.hidden) for c in range(3)]
    exact = np.stack([area_transport(each).sum(axis=1) for each in channels], axis=1)
    assert error(exact, pictures) < 1e-3


def test_albedo_follows_a_camera_that_moves_over_a_texture(room):
    wall = room.wall(diffuse(TILES))
    camera = '<default name="dx" value="0"/>' + room.camera().replace(
        "</transform>", '<translate x="$dx"/></transform>', 1
    )
    path = room.write(wall=wall, camera=camera)
    moved = load_scenario(path, (2, 3)).at(dx=0.05).view
    anew = load_scenario(path, (2, 3), {"dx": "0.05"}).view
    for name in ("reflectance", "texture"):
        np.testing.assert_allclose(getattr(moved, name), getattr(anew, name), atol=5e-3)
    still = load_scenario(path, (2, 3)).view
    assert np.abs(still.reflectance - moved.reflectance).max() > 0.1


def test_texture_is_averaged_once_for_a_place_of_the_camera(room, monkeypatch):
    camera = '<default name="dx" value="0"/>' + room.camera().replace(
        "</transform>", '<translate x="$dx"/></transform>', 1
    )
    seen = load_scenario(room.write(wall=room.wall(diffuse(TILES)), camera=camera), (2, 3))
    traced, trace = [], load.trace_texture
    monkeypatch.setattr(load, "trace_texture", lambda *of: traced.append(of) or trace(*of))
    for _ in range(3):
        for dx in (0.01, 0.02):
            seen.at(dx=dx)
    assert len(traced) == 2


@pytest.mark.usefixtures("few_paths")
def test_smooth_light_is_that_of_the_even_wall_times_its_paint(room, monkeypatch):
    monkeypatch.setattr(ambient, "RAYS", 16)
    seen = room.load(wall=room.wall(diffuse(TILES)), monitor=room.monitor(room.area))
    even = Scenario(seen.view.even, seen.hidden)
    np.testing.assert_allclose(
        point_light_backgrounds(seen), point_light_backgrounds(even) * seen.paint, rtol=1e-6
    )
    lights = [render_background("ambient/overcast", each, target=0.3) for each in (seen, even)]
    on_texture, on_even = (each.photograph.reshape(-1, 3) for each in lights)
    np.testing.assert_allclose(
        on_texture / seen.channel_gain, on_even / even.channel_gain * seen.paint, rtol=1e-5
    )
    bounced, plain = (render_bounced_light(each, target=0.4) for each in (seen, even))
    np.testing.assert_allclose(bounced.over_wall, plain.over_wall * seen.paint, rtol=1e-5)


def test_dark_colours_leave_finite_gains_and_rows_of_little_weight(room):
    view = room.load(wall=room.wall(diffuse(checkered("1, 0, 0", "0.5", 3)))).view
    assert 0 < view.albedo.min() < 1e-3
    assert 0.3 < view.channel_gain.min() < view.channel_gain.max() < 1e5


@pytest.mark.parametrize(
    ("name", "values", "reason"),
    [
        ("black", 0.0, "reflects nothing"),
        ("negative", -0.2, "no number from 0 on"),
        ("unknown", np.nan, "no number from 0 on|NaN"),
    ],
)
def test_texture_without_a_mean_is_refused(room, name, values, reason):
    albedo = np.full((8, 8, 3), 0.5, np.float32) * (name != "black")
    albedo[2:6, 2:6] = values
    mi.Bitmap(albedo).write(str(room.folder / f"{name}.exr"))
    with pytest.raises(SceneError, match=reason):
        room.load(wall=room.wall(diffuse(bitmap("reflectance", f"{name}.exr"))))


def test_texture_that_a_cannot_represent_is_refused(room):
    with pytest.raises(SceneError, match=r"missing\.png"):
        room.load(wall=room.wall(diffuse(bitmap("reflectance", "missing.png"))))
    glossy = checkered("0.8", "0.2", 9, name="diffuse_reflectance")
    with pytest.raises(SceneError, match="from place to place"):
        room.load(wall=room.wall(f'<bsdf type="roughplastic">{glossy}</bsdf>'))
    corners = "".join(f"v {x} 1 {z}\n" for x, z in ((-1, -1), (2, -1), (2, 2), (-1, 2)))
    (room.folder / "wall.obj").write_text(corners + "f 1 2 3\nf 1 3 4\n")
    mesh = '<shape type="obj" id="wall"><string name="filename" value="wall.obj"/>{}</shape>'
    with pytest.raises(SceneError, match="no UV coordinates"):
        room.load(wall=mesh.format(f'<bsdf type="twosided">{diffuse(TILES)}</bsdf>'))


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
