import numpy as np
import pytest

from periscopy_sim.rendering.ambient.irradiance import BouncedIrradiance, direct_irradiance
from periscopy_sim.rendering.photograph import path_trace
from periscopy_sim.view import pixel_edges
from tests.scenes.irradiance import polygon_irradiance
from tests.scenes.lamps import LIGHT, point_light, scene_of

# The wall of the room's scenes is at y = 1 and faces -y; its albedo is 0.5.
TOWARD_ROOM = np.array([0.0, -1.0, 0.0])
ACROSS, DOWN = np.array([1.0, 0, 0]), np.array([0, 0, -1.0])
SEEDS = range(8)


def on_wall(side, spacing):
    """(side², 3) points just off the wall about (0.7, 1, 0.3), row by row; normals; edges."""
    offset = spacing * (np.arange(side) - (side - 1) / 2)
    down, across = (grid.ravel()[:, None] for grid in np.meshgrid(offset, offset, indexing="ij"))
    points = np.array([0.7, 1 - 5e-5, 0.3]) + down * DOWN + across * ACROSS
    normals = np.broadcast_to(TOWARD_ROOM, points.shape)
    return points, normals, pixel_edges(points, normals, (side, side))


def direct(path, placed, samples=64):
    scene = scene_of(path)
    return np.stack(
        [direct_irradiance(scene, scene.emitters()[0], *placed, samples, seed) for seed in SEEDS]
    )


@pytest.fixture
def same_at_each_point(same_mean):
    """Compare (seeds, points, 3), point by point: points that share their paths are correlated."""

    def check(a, b):
        for point in range(a.shape[1]):
            same_mean(a[:, point : point + 1], b[:, point : point + 1])

    return check


def shape(name, transform, reflectance="0", inside=""):
    """A rectangle in the xy plane that faces +z, then transformed."""
    return (
        f'<shape type="rectangle" id="{name}"><transform name="to_world">{transform}</transform>'
        f'<bsdf type="diffuse"><rgb name="reflectance" value="{reflectance}"/></bsdf>{inside}'
        "</shape>"
    )


def test_point_light_falls_off_with_the_cosine_and_the_square_of_the_distance(room):
    placed = on_wall(4, 0.004)
    found = direct(room.write(LIGHT, monitor=""), placed)
    # Over so small a pixel the light is even.
    np.testing.assert_allclose(found, np.stack([point_light(placed[0])] * len(SEEDS)), rtol=1e-3)


def test_direct_light_is_averaged_over_each_pixel(room, same_mean):
    points, normals, edges = on_wall(3, 0.7)
    found = direct(room.write(LIGHT, monitor=""), (points, normals, edges))
    ticks = (np.arange(40) + 0.5) / 40 - 0.5
    down, across = np.meshgrid(ticks, ticks)
    inside = down[..., None, None] * edges[:, 0] + across[..., None, None] * edges[:, 1]
    expected = point_light(points + inside).mean(axis=(0, 1))
    assert np.abs(point_light(points) / expected - 1).max() > 0.03
    same_mean(found, np.stack([expected] * len(SEEDS)))


def test_area_light_follows_lamberts_formula(room, same_mean):
    placed = on_wall(3, 0.002)
    lamp = shape(
        "lamp",
        '<scale x="0.3" y="0.1"/><rotate x="1" angle="-90"/><translate x="0.9" y="0.2" z="0.5"/>',
        inside=room.area,
    )
    corners = np.array([[1.2, 0.2, 0.6], [0.6, 0.2, 0.6], [0.6, 0.2, 0.4], [1.2, 0.2, 0.4]])
    expected = np.array([polygon_irradiance(p, TOWARD_ROOM, corners) for p in placed[0]])
    found = direct(room.write(lamp, monitor=""), placed, 256)
    same_mean(found, np.broadcast_to(expected[:, None], found.shape))
    assert found.std(axis=0).max() < 0.02 * expected.mean()


def test_even_sky_gives_pi_times_its_radiance(room, same_mean):
    sky = '<emitter type="constant"><rgb name="radiance" value="1, 2, 4"/></emitter>'
    found = direct(room.write(sky, monitor=""), on_wall(3, 0.1), 1024)
    same_mean(found, np.broadcast_to(np.pi * np.array([1.0, 2, 4]), found.shape))


FLOOR = shape("floor", '<scale value="0.8"/><translate x="0.7" y="0.2" z="-0.2"/>', "0.7, 0.5, 0.2")
LEFT = '<scale value="0.8"/><rotate y="1" angle="90"/><translate x="0" y="0.2" z="0.3"/>'


def panel(room):
    up_there = '<rotate x="1" angle="180"/><translate x="0.9" y="0.1" z="1.5"/>'
    return shape("panel", f'<scale value="0.6"/>{up_there}', inside=room.area)


def side_wall(bsdf):
    return (
        f'<shape type="rectangle" id="side"><transform name="to_world">{LEFT}</transform>{bsdf}'
        "</shape>"
    )


SIDES = {
    "diffuse": '<bsdf type="diffuse"><rgb name="reflectance" value="0.4, 0.5, 0.8"/></bsdf>',
    "mirror": '<bsdf type="conductor"/>',
    "glossy": '<bsdf type="roughconductor"><float name="alpha" value="0.3"/></bsdf>',
}

# A board that stands on the wall, so that points at its right see nothing of what is at its left.
SLAB = (
    '<shape type="cube" id="slab"><transform name="to_world"><scale x="0.002" y="0.15" z="0.5"/>'
    '<translate x="0.7" y="0.84" z="0.3"/></transform><bsdf type="diffuse">'
    '<rgb name="reflectance" value="0"/></bsdf></shape>'
)


def bounced(scene, points, normals, paths):
    """(seeds, points, 3)."""
    estimates = BouncedIrradiance(scene, points, normals, paths)
    return np.stack([estimates.estimate(seed) for seed in SEEDS])


def bounced_as_path_traced(path, samples):
    """(seeds, 25, 3) irradiance at 5 x 5 pixels of 25 x 25 by all paths less the direct ones."""
    scene = scene_of(path)
    pictures = []
    for seed in SEEDS:
        whole, first = (
            path_trace(scene, depth, samples=samples, seed=10 * seed + depth + 1)
            for depth in (-1, 2)
        )
        pictures.append((whole - first)[2::5, 2::5].reshape(25, 3) * np.pi / 0.5)
    return np.stack(pictures)


@pytest.mark.thorough
@pytest.mark.parametrize("side", [*SIDES, "slab"])
def test_bounced_light_is_that_of_brute_force(side, room, same_at_each_point):
    stands = SLAB if side == "slab" else ""
    path = room.write(
        *(FLOOR, panel(room), side_wall(SIDES.get(side, SIDES["diffuse"])), stands),
        monitor="",
        camera=room.camera((25, 25)),
    )
    points, normals, _ = on_wall(5, 0.08)
    # The middle column would lie under the slab.
    seen = np.arange(25) % 5 != 2 if side == "slab" else np.full(25, True)
    scene = scene_of(path)
    found = bounced(scene, points[seen], normals[seen], 400)
    brute = bounced_as_path_traced(path, 144)[:, seen]
    same_at_each_point(found, brute)
    errors = found.mean(axis=0) / brute.mean(axis=0) - 1
    assert np.sqrt(np.mean(errors**2)) < 0.08
    means = found.mean(axis=(0, 2))
    assert np.ptp(means) > 0.2 * means.mean()
