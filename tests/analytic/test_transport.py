import signal
import subprocess
import sys
import threading
import time
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from scipy import integrate, ndimage
from scipy.spatial.transform import Rotation

from periscopy_sim.analytic.transport import analytic_transport
from periscopy_sim.errors import SceneError
from periscopy_sim.scenario import EmissionProfile, Occluder, Scenario

ROOT = Path(__file__).parents[2]
D = 1.03
FINE = (40, 43)
LCD = EmissionProfile(18, 1)
LAMBERTIAN = EmissionProfile(0, 0)
PLACES = ("wall_points", "patch_centers")
DIRECTIONS = ("wall_normals", "patch_normals", "patch_across", "patch_up")
# Corner number 4x + 2y + z of a unit box; outward quadrilaterals.
BOX_QUADS = np.array(
    [[0, 1, 3, 2], [4, 6, 7, 5], [0, 4, 5, 1], [2, 3, 7, 6], [0, 2, 6, 4], [1, 5, 7, 3]]
)


def grid(rows, columns):
    """Positions across and up in a unit square about 0, row by row from the top."""
    row, column = np.divmod(np.arange(rows * columns), columns)
    return np.stack([(column + 0.5) / columns - 0.5, 0.5 - (row + 0.5) / rows], axis=1)


def make_scenario(occluders=(), *, film=(9, 11), hidden=(2, 3), emission=LCD, size=0.4):
    """Wall at y = D seen squarely, monitor at y = 0 facing it, both off centre."""
    wall = np.array([0.74, D, 0.26]) + size * grid(*film) @ [[1, 0, 0], [0, 0, 1]]
    monitor = np.array([[-0.4, 0, 0], [0, 0, 0.3]])
    patches = np.prod(hidden)
    return Scenario(
        path=Path("room.xml"),
        parameters={},
        photograph_shape=film,
        hidden_shape=hidden,
        wall_points=wall,
        wall_normals=np.tile([0.0, -1.0, 0.0], (len(wall), 1)),
        wall_reflectance=np.full(3, 0.8),
        channel_gain=np.ones(3),
        patch_centers=np.array([0.23, 0, 0.29]) + grid(*hidden) @ monitor,
        patch_normals=np.tile([0.0, 1.0, 0.0], (patches, 1)),
        patch_across=np.tile(monitor[0] / hidden[1], (patches, 1)),
        patch_up=np.tile(monitor[1] / hidden[0], (patches, 1)),
        mirrored=False,
        emission=emission,
        occluders=tuple(occluders),
    )


def move(scenario, linear, shift):
    """Apply an orthogonal map and a shift to the whole scene."""
    turned = {name: getattr(scenario, name) @ linear.T for name in DIRECTIONS}
    moved = {name: getattr(scenario, name) @ linear.T + shift for name in PLACES}
    occluders = tuple(
        replace(occluder, vertices=occluder.vertices @ linear.T + shift)
        for occluder in scenario.occluders
    )
    return replace(scenario, occluders=occluders, **turned, **moved)


class Box:
    """Oriented box, known to the oracle by its six half-spaces and to the code by triangles."""

    def __init__(self, center, size, rotation=None):
        self.center, self.half = np.array(center), np.array(size) / 2
        self.axes = np.eye(3) if rotation is None else rotation.as_matrix()

    @classmethod
    def random(cls, rng):
        center = rng.uniform([0.35, 0.35, 0.15], [0.6, 0.7, 0.4])
        return cls(center, rng.uniform(0.02, 0.15, 3), Rotation.random(rng=rng))

    def occluder(self, name="box"):
        signs = 2 * np.array([[n >> 2 & 1, n >> 1 & 1, n & 1] for n in range(8)]) - 1
        vertices = self.center + (signs * self.half) @ self.axes.T
        return Occluder(name, vertices, np.concatenate([BOX_QUADS[:, :3], BOX_QUADS[:, [0, 2, 3]]]))

    def blocks(self, q, points):
        """Whether the segment from q to each point has a piece within all six half-spaces."""
        enter, leave = np.zeros(len(points)), np.ones(len(points))
        for axis, half in zip(self.axes.T, self.half, strict=True):
            for side in (-1, 1):
                start = side * (q - self.center) @ axis - half
                rate = side * (points - q) @ axis
                crossing = -start / rate
                enter = np.where(rate < 0, np.maximum(enter, crossing), enter)
                leave = np.where(rate > 0, np.minimum(leave, crossing), leave)
        return enter < leave


def soup(occluder):
    corners = occluder.vertices[occluder.faces].reshape(-1, 3)
    return replace(occluder, vertices=corners, faces=np.arange(len(corners)).reshape(-1, 3))


def merged(*occluders, name="furniture"):
    first = np.cumsum([0] + [len(o.vertices) for o in occluders])
    faces = [o.faces + n for o, n in zip(occluders, first, strict=False)]
    return Occluder(name, np.concatenate([o.vertices for o in occluders]), np.concatenate(faces))


def welded(occluder):
    vertices, index = np.unique(occluder.vertices.round(9), axis=0, return_inverse=True)
    return replace(occluder, vertices=vertices, faces=index[occluder.faces])


def oracle(scenario, strata, boxes=()):
    """The matrix by explicit angles, sample by sample, shadows by clipping segments."""
    A = np.zeros((len(scenario.wall_points), len(scenario.patch_centers)))
    down, across = strata
    for j, center in enumerate(scenario.patch_centers):
        e_across, e_up = scenario.patch_across[j], scenario.patch_up[j]
        for row in range(down):
            for column in range(across):
                q = center + ((column + 0.5) / across - 0.5) * e_across
                q = q - ((row + 0.5) / down - 0.5) * e_up
                d = scenario.wall_points - q
                r = np.linalg.norm(d, axis=1)
                ahead = d @ scenario.patch_normals[j]
                horizontal = np.arctan2(d @ e_across / np.linalg.norm(e_across), ahead)
                vertical = np.arctan2(d @ e_up / np.linalg.norm(e_up), ahead)
                value = np.cos(horizontal) ** scenario.emission.horizontal
                value *= np.cos(vertical) ** scenario.emission.vertical
                value *= ahead / r * -np.sum(d * scenario.wall_normals, axis=1) / r / r**2
                value[ahead <= 0] = 0
                for box in boxes:
                    value[box.blocks(q, scenario.wall_points)] = 0
                A[:, j] += value
    area = np.linalg.norm(np.cross(scenario.patch_across, scenario.patch_up), axis=1)
    return A * scenario.wall_reflectance.mean() / np.pi * area / (down * across)


def tilt_monitor(scenario, degrees):
    """Turn the monitor about a vertical axis through its middle."""
    turn = Rotation.from_euler("z", degrees, degrees=True).as_matrix().T
    middle = scenario.patch_centers.mean(axis=0)
    return replace(
        scenario,
        patch_centers=(scenario.patch_centers - middle) @ turn + middle,
        patch_normals=scenario.patch_normals @ turn,
        patch_across=scenario.patch_across @ turn,
        patch_up=scenario.patch_up @ turn,
    )


def lambert_irradiance(point, normal, corners):
    """Irradiance of unit radiance from a polygon, by Lambert's contour formula."""
    rays = corners - point
    rays /= np.linalg.norm(rays, axis=1, keepdims=True)
    total = 0.0
    for a, b in zip(rays, np.roll(rays, -1, axis=0), strict=True):
        across = np.cross(a, b)
        total += np.arccos(a @ b) * (across @ normal) / np.linalg.norm(across)
    return abs(total) / 2


@pytest.mark.parametrize("degrees", [0, 25])
def test_an_unoccluded_lambertian_monitor_matches_lamberts_contour_formula(degrees):
    scenario = tilt_monitor(make_scenario(film=(3, 4), emission=LAMBERTIAN), degrees)
    A = analytic_transport(scenario, samples=400)
    for i, point in enumerate(scenario.wall_points):
        for j, center in enumerate(scenario.patch_centers):
            across, up = scenario.patch_across[j] / 2, scenario.patch_up[j] / 2
            corners = center + np.array([-across - up, across - up, across + up, up - across])
            irradiance = lambert_irradiance(point, scenario.wall_normals[i], corners)
            assert A[i, j] == pytest.approx(0.8 / np.pi * irradiance, rel=1e-4)


def test_an_unoccluded_lcd_patch_matches_adaptive_quadrature():
    scenario = make_scenario(film=(1, 1), hidden=(1, 1))
    (x, y, z), (px, _, pz) = scenario.wall_points[0], scenario.patch_centers[0]

    def integrand(dz, dx):
        across, up = x - px - dx, z - pz - dz
        r = (across**2 + up**2 + y**2) ** 0.5
        angles = np.cos(np.arctan(up / y)) ** 18 * np.cos(np.arctan(across / y))
        return 0.8 / np.pi * angles * (y / r) ** 2 / r**2

    expected, _ = integrate.dblquad(integrand, -0.2, 0.2, -0.15, 0.15, epsrel=1e-10)
    assert analytic_transport(scenario, samples=2500)[0, 0] == pytest.approx(expected, rel=2e-4)


@pytest.mark.parametrize("strata", [(1, 1), (2, 3), (1, 7), (4, 4)])
def test_samples_lie_in_the_middle_of_the_most_square_strata(strata):
    scenario = tilt_monitor(make_scenario(), 40)
    A = analytic_transport(scenario, samples=strata[0] * strata[1])
    np.testing.assert_allclose(A, oracle(scenario, strata), rtol=2e-6)


def test_the_albedo_is_the_mean_over_the_channels():
    white = replace(make_scenario(), wall_reflectance=np.ones(3))
    colored = replace(white, wall_reflectance=np.array([0.1, 0.2, 0.9]))
    np.testing.assert_allclose(
        analytic_transport(colored), 0.4 * analytic_transport(white), rtol=1e-6
    )


def test_nothing_reaches_points_behind_or_beside_the_monitor():
    scenario = tilt_monitor(make_scenario(size=6.0, emission=LAMBERTIAN), 60)
    ahead = (scenario.wall_points - scenario.patch_centers[0]) @ scenario.patch_normals[0]
    A = analytic_transport(scenario)
    assert 0 < (ahead < 0).sum() < ahead.size
    assert (A[ahead < 0] == 0).all()
    assert (A[ahead > 0.1] > 0).all()


def test_nothing_comes_through_the_wall():
    front = make_scenario()
    behind = replace(front, wall_normals=-front.wall_normals)
    assert (analytic_transport(behind) == 0).all()


def test_a_direction_within_the_monitors_plane_carries_nothing():
    edge_on = replace(
        make_scenario(film=(1, 1), hidden=(1, 1)),
        wall_points=np.array([[0.23, D, 0.29]]),
        patch_normals=np.array([[1.0, 0, 0]]),
        patch_across=np.array([[0, 0.4, 0]]),
    )
    assert analytic_transport(edge_on, samples=1) == 0


@pytest.mark.parametrize("emission", [LAMBERTIAN, LCD])
def test_a_large_wall_receives_the_power_that_a_patch_emits_and_no_more(emission):
    scenario = make_scenario(film=(400, 400), hidden=(1, 1), emission=emission, size=40.0)
    irradiance = analytic_transport(scenario, samples=16) * np.pi / 0.8
    received = irradiance.sum() * (40 / 400) ** 2

    def radiant_intensity(across, up):
        # Over the plane at unit distance: cos² θ is the foreshortening of solid angle twice.
        profile = np.cos(np.arctan(up)) ** emission.vertical
        profile = profile * np.cos(np.arctan(across)) ** emission.horizontal
        return profile / (1 + across**2 + up**2) ** 2

    half = 40 / 2 / D
    expected, _ = integrate.dblquad(radiant_intensity, -half, half, -half, half)
    assert received == pytest.approx(0.4 * 0.3 * expected, rel=5e-3)
    assert received < 0.4 * 0.3 * np.pi


@pytest.mark.parametrize("seed", range(6))
@pytest.mark.parametrize("degrees", [0, 20])
def test_shadows_match_segments_clipped_by_half_spaces(seed, degrees):
    rng = np.random.default_rng(seed)
    boxes = [Box.random(rng) for _ in range(3)]
    assert_shadows_match(tilt_monitor(make_scenario(film=FINE), degrees), boxes)


def test_a_box_that_stands_against_the_wall_shades_what_lies_beside_it():
    assert_shadows_match(make_scenario(film=FINE), [Box([0.5, D - 0.1, 0.26], [0.1, 0.2, 0.3])])


def assert_shadows_match(scenario, boxes):
    expected = oracle(scenario, (2, 3), boxes)
    assert 0.01 < (expected == 0).mean() < 0.99
    scenario = replace(scenario, occluders=tuple(box.occluder() for box in boxes))
    np.testing.assert_allclose(analytic_transport(scenario, samples=6), expected, rtol=2e-6)


def test_overlapping_shadows_count_once():
    rng = np.random.default_rng(3)
    boxes = [Box.random(rng) for _ in range(2)]
    first, second = (box.occluder() for box in boxes)
    once = analytic_transport(make_scenario([first, second], film=(20, 21)))
    twice = analytic_transport(make_scenario([second, first, second, first], film=(20, 21)))
    np.testing.assert_array_equal(once, twice)
    assert (once >= 0).all()


def test_a_box_as_loose_triangles_casts_the_box_shadow():
    box = Box.random(np.random.default_rng(1)).occluder()
    whole = make_scenario([box], film=(60, 61))
    loose = make_scenario([soup(box)], film=(60, 61))
    np.testing.assert_array_equal(analytic_transport(loose), analytic_transport(whole))


def test_a_non_convex_part_is_refused_by_name_and_accepted_once_split():
    foot = Box([0.45, 0.525, 0.22], [0.1, 0.05, 0.04])
    back = Box([0.42, 0.525, 0.27], [0.04, 0.05, 0.06])
    shelf = merged(foot.occluder(), back.occluder(), name="shelf")
    with pytest.raises(SceneError, match=r"'shelf' has a part about .* split it into such parts"):
        analytic_transport(make_scenario([welded(shelf)]))
    A = analytic_transport(make_scenario([shelf], film=FINE), samples=6)
    expected = oracle(make_scenario(film=FINE), (2, 3), [foot, back])
    np.testing.assert_allclose(A, expected, rtol=2e-6)


@pytest.mark.parametrize("determinant", [1, -1])
def test_moving_or_mirroring_the_whole_scene_changes_nothing(determinant):
    rng = np.random.default_rng(5)
    scenario = make_scenario([Box.random(rng).occluder(), Box.random(rng).occluder()])
    linear = determinant * Rotation.from_euler("zyx", [0.7, -1.1, 2.0]).as_matrix()
    moved = move(scenario, linear, np.array([0.3, -2.0, 1.0]))
    A = analytic_transport(scenario)
    assert (A == 0).any()
    np.testing.assert_allclose(analytic_transport(moved), A, rtol=1e-6)


def bent(values, amount=1e-4):
    """Vary values of points or patches across their first axis."""
    return values + amount * np.sin(np.arange(len(values)))[:, None] * [0, 1, 0]


def at(y):
    return (Box([0.45, y, 0.25], [0.1, 0.1, 0.1]).occluder("stool"),)


SCENE = make_scenario(at(0.5))  # which the model can treat
NOT_A_GRID = "'monitor' is not a planar grid of equal parallelograms"
REFUSALS = [
    ("wall_reflectance", None, "'wall' is not diffuse"),
    ("wall_points", bent(SCENE.wall_points), "'wall' is not one plane"),
    ("wall_normals", bent(SCENE.wall_normals), "'wall' is not one plane"),
    ("emission", None, "'monitor' has no closed angular profile"),
    ("patch_centers", bent(SCENE.patch_centers), NOT_A_GRID),
    ("patch_centers", SCENE.patch_centers * [1.1, 1, 1], NOT_A_GRID),
    ("patch_normals", bent(SCENE.patch_normals), NOT_A_GRID),
    ("patch_up", SCENE.patch_up * np.linspace(0.9, 1, 6)[:, None], NOT_A_GRID),
    ("patch_normals", SCENE.patch_normals + np.array([0.1, 0, 0]), NOT_A_GRID),
    ("patch_normals", SCENE.patch_normals + np.array([0, 0, 0.1]), NOT_A_GRID),
    ("occluders", (Occluder("ball", None, None),), "'ball' has no triangles"),
    ("occluders", at(1.0), "'stool' reaches behind the wall"),
    ("occluders", at(0.05), "'stool' reaches the monitor's plane"),
    ("occluders", at(-1), "'stool' reaches the monitor's plane"),
]


@pytest.mark.parametrize(("field", "value", "words"), REFUSALS)
def test_what_the_model_cannot_treat_is_refused_by_name(field, value, words):
    with pytest.raises(SceneError, match=words) as refusal:
        analytic_transport(replace(SCENE, **{field: value}), samples=1)
    assert "room.xml" in str(refusal.value)
    assert "render_transport" in str(refusal.value)


def test_an_occluder_beside_a_tilted_monitor_is_refused():
    beside = tilt_monitor(make_scenario([Box([0.36, 0.1, 0.25], [0.05] * 3).occluder("vase")]), -80)
    with pytest.raises(SceneError, match="'vase' is no nearer to the wall than the monitor"):
        analytic_transport(beside)


def test_textured_wall_is_refused_by_name():
    with pytest.raises(SceneError, match=r"shape 'wall' is textured; give it one reflectance"):
        analytic_transport(replace(make_scenario(), wall_texture=np.ones(99)))


def test_no_samples_are_refused():
    with pytest.raises(ValueError, match="0 samples"):
        analytic_transport(make_scenario(), samples=0)


def test_progress_runs_to_one_and_runs_give_the_same_bytes():
    fractions = []
    A = analytic_transport(SCENE, progress=fractions.append)
    assert fractions == sorted(fractions)
    assert fractions[-1] == 1
    assert A.dtype == np.float32
    assert A.tobytes() == analytic_transport(SCENE).tobytes()


def test_an_interruption_through_progress_stops_the_work():
    def stop(_):
        raise KeyboardInterrupt

    with pytest.raises(KeyboardInterrupt):
        analytic_transport(make_scenario(hidden=(9, 11)), progress=stop)


def test_importing_the_model_loads_no_compiler_and_no_renderer():
    heavy = "{'numba', 'scipy', 'mitsuba', 'drjit'}"
    code = f"import sys, periscopy_sim.analytic.transport; print({heavy} & set(sys.modules))"
    command = [sys.executable, "-c", code]
    assert subprocess.check_output(command, cwd=ROOT, text=True).strip() == "set()"


def test_the_ray_tracer_agrees(monkeypatch):
    from periscopy_sim.rendering.scene.load import load_scenario
    from periscopy_sim.rendering.transport.shadow_rays import render_transport
    from periscopy_sim.rendering.variant import OVERRIDE, examine_variants

    fast = [v.name for v in examine_variants() if v.works and not v.name.startswith("scalar")]
    if not fast:
        pytest.skip("no vectorized Mitsuba variant works here")
    monkeypatch.setenv(OVERRIDE, fast[0])
    chair = load_scenario(ROOT / "scenes" / "chair.xml", (6, 8), {"resolution": 32})
    rendered = render_transport(chair, samples=100, strata="midpoint")
    A = analytic_transport(chair, samples=100)
    unoccluded = analytic_transport(replace(chair, occluders=()), samples=100)
    # One pixel away from penumbrae: the ray tracer's shadow rays start a little off the wall.
    sunny = ndimage.binary_erosion(
        (unoccluded == A).reshape(*chair.photograph_shape, -1), np.ones((3, 3, 1)), border_value=1
    ).reshape(A.shape)
    assert 0.3 < sunny.mean() < 0.95
    np.testing.assert_allclose(A[sunny], rendered[sunny], rtol=1e-4)
    assert np.linalg.norm(A - rendered) < 0.01 * np.linalg.norm(rendered)


def test_interrupt_stops_the_columns_that_are_begun():
    scenario = make_scenario()
    analytic_transport(scenario, samples=1)  # compiles
    start = time.monotonic()
    threading.Timer(0.3, signal.raise_signal, (signal.SIGINT,)).start()
    with pytest.raises(KeyboardInterrupt):
        analytic_transport(scenario, samples=10**7)  # hours
    assert time.monotonic() - start < 20
