from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from periscopy_sim.analytic.area_transport import analytic_transport
from periscopy_sim.errors import SceneError
from periscopy_sim.scenario import EmissionProfile, Occluder, Scenario, SceneDocument
from tests.irradiance import polygon_irradiance

D = 1.03
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
        document=SceneDocument(Path("room.xml")),
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


@pytest.mark.parametrize("degrees", [0, 25])
def test_an_unoccluded_lambertian_monitor_matches_lamberts_contour_formula(degrees):
    scenario = tilt_monitor(make_scenario(film=(3, 4), emission=LAMBERTIAN), degrees)
    A = analytic_transport(scenario)
    for i, point in enumerate(scenario.wall_points):
        for j, center in enumerate(scenario.patch_centers):
            across, up = scenario.patch_across[j] / 2, scenario.patch_up[j] / 2
            corners = center + np.array([-across - up, across - up, across + up, up - across])
            irradiance = polygon_irradiance(point, scenario.wall_normals[i], corners)
            assert A[i, j] == pytest.approx(0.8 / np.pi * irradiance, rel=1e-4)


@pytest.mark.parametrize("determinant", [1, -1])
def test_moving_or_mirroring_the_whole_scene_changes_nothing(determinant):
    rng = np.random.default_rng(5)
    scenario = make_scenario([Box.random(rng).occluder(), Box.random(rng).occluder()])
    linear = determinant * Rotation.from_euler("zyx", [0.7, -1.1, 2.0]).as_matrix()
    moved = move(scenario, linear, np.array([0.3, -2.0, 1.0]))
    A = analytic_transport(scenario)
    assert (A == 0).any()
    np.testing.assert_allclose(analytic_transport(moved), A, rtol=2e-4, atol=1e-6 * A.max())


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
    ("patch_normals", bent(SCENE.patch_normals), NOT_A_GRID),
    ("patch_up", SCENE.patch_up * np.linspace(0.9, 1, 6)[:, None], NOT_A_GRID),
    ("occluders", (Occluder("ball", None, None),), "'ball' has no triangles"),
    ("occluders", at(1.0), "'stool' reaches the wall's nearest"),
    ("occluders", at(0.05), "'stool' reaches the monitor's plane"),
]


@pytest.mark.parametrize(("field", "value", "words"), REFUSALS)
def test_what_the_model_cannot_treat_is_refused_by_name(field, value, words):
    with pytest.raises(SceneError, match=words) as refusal:
        analytic_transport(replace(SCENE, **{field: value}))
    assert "room.xml" in str(refusal.value)
    assert "render_transport" in str(refusal.value)
