import numpy as np
import pytest
from scipy import stats

from periscopy_sim.errors import SceneError
from periscopy_sim.rendering.ambient import (
    BouncedIrradiance,
    direct_irradiance,
    relative_errors,
    render_background,
)
from periscopy_sim.rendering.photograph import path_trace
from periscopy_sim.view import pixel_edges
from tests.scenes.irradiance import polygon_irradiance
from tests.scenes.lamps import LIGHT, point_light, scene_of
from tests.scenes.room import Room

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


COARSE = {"target": 1.0}


@pytest.fixture
def few_paths(monkeypatch):
    """Paths of each of 144 sites serve all others: of few, the noise is small enough."""
    monkeypatch.setattr("periscopy_sim.rendering.ambient.RAYS", 16)


@pytest.fixture
def office(room, few_paths):  # noqa: ARG001
    """Wall, coloured floor and bookshelf, lit by a panel."""

    def plane(name, x, y, z, turn, color, inside=""):
        return (
            f'<shape type="rectangle" id="{name}"><transform name="to_world"><scale value="0.8"/>'
            f'{turn}<translate x="{x}" y="{y}" z="{z}"/></transform><bsdf type="diffuse">'
            f'<rgb name="reflectance" value="{color}"/></bsdf>{inside}</shape>'
        )

    left = '<rotate y="1" angle="90"/>'
    down = '<rotate x="1" angle="180"/>'
    return room.write(
        plane("floor", 0.7, 0.2, -0.2, "", "0.7, 0.5, 0.2"),
        plane("shelf", 0.0, 0.2, 0.3, left, "0.4, 0.5, 0.8"),
        plane("panel", 0.9, 0.1, 1.5, down, "0", room.area),
        monitor="",
        camera=room.camera((12, 12)),
    )


@pytest.fixture
def scenario(room):
    """The room, seen as in the office."""
    return room.load(camera=room.camera((12, 12)))


@pytest.mark.thorough
def test_background_is_what_path_tracing_the_ambient_scene_gives(office, scenario, same_mean):
    found = [render_background(office, scenario, seed=seed, target=2e-3) for seed in range(8)]
    pictures = np.stack([background.photograph for background in found])
    scene = scene_of(office)
    whole = np.stack([path_trace(scene, -1, samples=900, seed=100 + seed) for seed in range(8)])
    # Smoothing spreads noise over the picture, so that pixels are not independent.
    same_mean(*(np.mean(x, axis=(1, 2), keepdims=True) for x in (pictures, whole)))
    mean, brute = pictures.mean(axis=0), whole.mean(axis=0)
    noise = whole.std(axis=0, ddof=1) / np.sqrt(8)
    told = found[0].relative_error * brute / np.sqrt(8)
    deviation = np.sqrt(np.mean((mean / mean.mean() - brute / brute.mean()) ** 2)) * brute.mean()
    assert deviation < 1.3 * np.sqrt(np.mean(noise**2 + told**2))
    assert deviation < 0.004 * brute.mean()
    assert np.ptp(brute[..., 0]) > 0.1 * brute.mean()


def test_light_that_does_not_bounce_is_the_direct_light_alone(room):
    scenario = room.load()
    found = render_background(room.write(LIGHT, monitor=""), scenario)
    x = 0.7 + 0.4 / 6 * (np.arange(6) - 2.5)
    z = 0.3 - 0.4 / 6 * (np.arange(5)[:, None] - 2)
    grid = np.stack(np.broadcast_arrays(x, 1.0, z), axis=-1)
    np.testing.assert_allclose(found.photograph, 0.5 / np.pi * point_light(grid), rtol=3e-3)
    assert found.relative_error <= 3e-4


def test_perspective_camera_sees_its_own_points_lit(room):
    """A camera that looks from the side photographs what lies about the ambient camera's centre."""
    camera = (
        '<sensor type="perspective" id="camera"><float name="fov" value="20"/>'
        '<transform name="to_world"><lookat origin="1.3, 0.2, 0.5" target="0.8, 1, 0.35" '
        'up="0, 0, 1"/></transform><film type="hdrfilm"><integer name="height" value="7"/>'
        '<integer name="width" value="9"/></film></sensor>'
    )
    scenario = room.load(camera=camera)
    points = scenario.view.centers.reshape(7, 9, 3)
    # The place lies as it is turned: across as far as the wall's plane allows.
    across = (points[:, -1] - points[:, 0]).mean(axis=0)
    across /= np.linalg.norm(across)
    up = np.cross(across, [0, 1, 0])
    edges = pixel_edges(scenario.view.centers, scenario.view.center_normals, (7, 9)).reshape(
        7, 9, 2, 3
    )
    offset = points - points.mean(axis=(0, 1))
    reach = [(np.abs(offset @ way) + np.abs(edges @ way).sum(-1) / 2).max() for way in (across, up)]
    offset *= min(np.divide([0.2, 0.2 * 5 / 6], reach))
    placed = np.stack([offset @ across + 0.7, np.full((7, 9), 1.0), offset @ up + 0.3], axis=-1)
    found = render_background(room.write(LIGHT, monitor=""), scenario, **COARSE)
    np.testing.assert_allclose(found.photograph, 0.5 / np.pi * point_light(placed), rtol=5e-3)
    assert np.ptp(placed[:, 0, 2]) != pytest.approx(np.ptp(placed[:, -1, 2]), rel=0.1)


CEILING = '<rotate x="1" angle="90"/><rotate z="1" angle="37"/>'
TILTED = '<rotate x="1" angle="20"/><translate x="1" y="-2" z="3"/>'


@pytest.mark.usefixtures("few_paths")
@pytest.mark.parametrize(
    ("width", "size", "moved"),
    [(0.96, (3, 6), ""), (0.05, (6, 4), TILTED), (2.0, (4, 4), CEILING),
     (0.4, (5, 6), '<scale value="0.01"/>')],
)  # fmt: skip
def test_place_has_the_size_of_what_the_camera_sees_in_any_frame(room, width, size, moved):
    camera = room.camera(size).replace('x="0.2" y="0.2"', f'x="{width / 2}" y="{width / 2}"')
    parts = room.wall(), room.monitor(), camera
    larger = parts[0].replace("<rotate", '<scale value="3"/><rotate', 1)
    wall, monitor, camera = (
        part.replace("</transform>", f"{moved}</transform>") for part in (larger, *parts[1:])
    )
    scenario = room.load(wall=wall, monitor=monitor, camera=camera, hidden=(1, 1))
    found = render_background(room.write(LIGHT, monitor=""), scenario, **COARSE)
    rows, columns = size
    pixel = min(0.4 / columns, 0.4 * 5 / 6 / rows)
    x = 0.7 + pixel * (np.arange(columns) - (columns - 1) / 2)
    z = 0.3 - pixel * (np.arange(rows)[:, None] - (rows - 1) / 2)
    grid = np.stack(np.broadcast_arrays(x, 1.0, z), axis=-1)
    np.testing.assert_allclose(found.photograph, 0.5 / np.pi * point_light(grid), rtol=5e-3)


@pytest.mark.usefixtures("few_paths")
def test_wall_that_bends_is_lit_all_over(room):
    wall = (
        '<shape type="cylinder" id="wall"><boolean name="flip_normals" value="true"/>'
        '<point name="p0" x="0.7" y="0" z="-1"/><point name="p1" x="0.7" y="0" z="2"/>'
        f'<float name="radius" value="1"/>{room.diffuse}</shape>'
    )
    sky = '<emitter type="constant"/>'
    found = render_background(room.write(sky, monitor=""), room.load(wall=wall), target=0.01)
    assert 0.45 < found.photograph.min() < found.photograph.max() < 0.52


@pytest.mark.thorough
def test_reported_error_is_the_scatter_over_seeds(office, scenario):
    count = 12
    found = [render_background(office, scenario, seed=seed, **COARSE) for seed in range(count)]
    pictures = np.stack([background.photograph for background in found])
    brightness = pictures.mean(axis=(1, 2, 3))
    scaled = pictures / brightness[:, None, None, None]
    scatter = np.mean(scaled.var(axis=0, ddof=1) / scaled.mean(axis=(0, 3))[..., None] ** 2)
    told = np.mean([background.relative_error**2 for background in found])
    # At worst all pixels vary as one; what is told has errors too, of 7 degrees for each seed.
    low, high = (stats.f.ppf(p, count - 1, 7 * count) for p in (1e-4, 1 - 1e-4))
    assert low < scatter / told < high
    scatter = brightness.var(ddof=1) / brightness.mean() ** 2
    told = np.mean([background.brightness_error**2 for background in found])
    assert low < scatter / told < high


def test_missed_target_warns(office, scenario):
    done: list[float] = []
    with pytest.warns(RuntimeWarning, match=r"stopped at a relative error of .*; raise max_rounds"):
        found = render_background(office, scenario, target=1e-7, max_rounds=3, progress=done.append)
    assert found.relative_error > 1e-7
    work = np.diff(done, prepend=0)  # of three rounds of each of two parts, the first two at once
    assert len(done) == 4 and 0.3 < done[0] < 0.4 and (work > 0).all() and done[-1] < 1


def test_same_seed_gives_the_same_picture_and_another_seed_another(office, scenario):
    first, again, other = (
        render_background(office, scenario, seed=seed, **COARSE).photograph for seed in (2, 2, 3)
    )
    assert first.shape == (12, 12, 3)
    np.testing.assert_allclose(again, first, rtol=1e-6)
    assert np.all(first != other)


@pytest.mark.parametrize(
    ("parts", "extra", "reason"),
    [
        ({"wall": ""}, LIGHT, "'wall'"),
        ({"camera": ""}, LIGHT, "'camera'"),
        ({}, "", "no emitter"),
        ({}, LIGHT.replace("-0.5", "2.5"), "no light reaches its wall"),
        ({}, LIGHT + Room.blocker("0.88, 0.97, 0.15", 0.01), "see its wall alone"),
    ],
)
def test_place_without_wall_camera_or_light_is_refused(room, parts, extra, reason):
    with pytest.raises(SceneError, match=reason):
        render_background(room.write(extra, monitor="", **parts), room.load(), **COARSE)


def test_relative_errors_leave_out_one_factor_and_count_noise_and_bias():
    rng, replicas = np.random.default_rng(0), 8
    picture, gains = rng.uniform(1, 3, (2000, 3)), 1 + 0.05 * rng.normal(size=replicas)
    scaled = gains[:, None, None] * picture
    exact, brightness = relative_errors(scaled, np.zeros(3))
    assert exact < 1e-12
    assert brightness == pytest.approx(gains.std(ddof=1) / gains.mean() / np.sqrt(replicas))
    grey = picture.mean(axis=1)[:, None]
    noise = 0.02 * grey * rng.normal(size=(replicas, 2000, 3))
    # 48,000 values: their standard deviation errs by 0.3 %.
    noisy, _ = relative_errors(scaled + noise, np.zeros(3))
    assert noisy == pytest.approx(0.02 / np.sqrt(replicas), rel=0.02)
    biased, _ = relative_errors(np.stack([picture] * replicas), np.full(3, 0.01))
    assert biased == pytest.approx(0.1 * np.sqrt(np.mean(grey**-2.0)), rel=1e-6)


def test_pixels_that_are_dark_in_every_replica_have_no_error():
    lit = 1 + 0.1 * np.random.default_rng(0).normal(size=(8, 500, 3))
    half = np.concatenate([lit, np.zeros_like(lit)], axis=1)
    alone, _ = relative_errors(lit, np.zeros(3))
    assert relative_errors(half, np.zeros(3))[0] == pytest.approx(alone / np.sqrt(2), rel=1e-9)
    assert relative_errors(np.zeros_like(lit), np.zeros(3)) == (0, 0)
