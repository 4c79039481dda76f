"""A wall and a monitor in formulas, and boxes between them with an oracle of their shadows."""

from dataclasses import replace
from pathlib import Path

import numpy as np
from scipy.spatial.transform import Rotation

from periscopy_sim.hidden import Hidden, Surface
from periscopy_sim.scenario import Scenario
from periscopy_sim.scene import EmissionProfile, Occluder, Scene, SceneDocument
from periscopy_sim.view import View

D = 1.03


LCD = EmissionProfile(18, 1)


LAMBERTIAN = EmissionProfile(0, 0)


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
    scene = Scene(
        document=SceneDocument(Path("room.xml")),
        places={},
        plugins={},
        boxes={},
        occluders=tuple(occluders),
        surfaces=(),
        emission={"monitor": emission},
    )
    ends = wall[[0, film[1] - 1, -1, -film[1]]]
    view = View(
        scene=scene,
        shape=film,
        points=wall[:, None],
        normals=np.tile([0.0, -1.0, 0.0], (len(wall), 1, 1)),
        rays=np.zeros((2, len(wall), 3)),
        corners=np.stack([ends, ends]),
        reflectance=np.full(3, 0.8),
        channel_gain=np.ones(3),
    )
    surface = Surface(
        shape=hidden,
        centers=np.array([0.23, 0, 0.29]) + grid(*hidden) @ monitor,
        normals=np.tile([0.0, 1.0, 0.0], (patches, 1)),
        across=np.tile(monitor[0] / hidden[1], (patches, 1)),
        up=np.tile(monitor[1] / hidden[0], (patches, 1)),
    )
    return Scenario(view, Hidden({"monitor": surface}))


def changed(scenario, *, scene=None, view=None, monitor=None):
    """The scenario with other fields of its scene, its view or its monitor."""
    world = replace(scenario.scene, **(scene or {}))
    surface = replace(scenario.hidden["monitor"], **(monitor or {}))
    seen = replace(scenario.view, **{"scene": world, **(view or {})})
    return Scenario(seen, Hidden({"monitor": surface}))


def move(scenario, linear, shift):
    """Apply an orthogonal map and a shift to the whole scene."""
    motion = np.eye(4)
    motion[:3, :3], motion[:3, 3] = linear, shift
    view, occluders = scenario.view, scenario.scene.occluders
    moved = [replace(each, vertices=each.vertices @ linear.T + shift) for each in occluders]
    return changed(
        Scenario(view, scenario.hidden.moved({"monitor": motion})),
        scene={"occluders": tuple(moved)},
        view={"points": view.points @ linear.T + shift, "normals": view.normals @ linear.T},
    )


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
    A = np.zeros((len(scenario.view.centers), len(scenario.hidden.centers)))
    down, across = strata
    for j, center in enumerate(scenario.hidden.centers):
        e_across, e_up = scenario.hidden.across[j], scenario.hidden.up[j]
        for row in range(down):
            for column in range(across):
                q = center + ((column + 0.5) / across - 0.5) * e_across
                q = q - ((row + 0.5) / down - 0.5) * e_up
                d = scenario.view.centers - q
                r = np.linalg.norm(d, axis=1)
                ahead = d @ scenario.hidden.normals[j]
                horizontal = np.arctan2(d @ e_across / np.linalg.norm(e_across), ahead)
                vertical = np.arctan2(d @ e_up / np.linalg.norm(e_up), ahead)
                value = np.cos(horizontal) ** scenario.scene.emission["monitor"].horizontal
                value *= np.cos(vertical) ** scenario.scene.emission["monitor"].vertical
                value *= ahead / r * -np.sum(d * scenario.view.center_normals, axis=1) / r / r**2
                value[ahead <= 0] = 0
                for box in boxes:
                    value[box.blocks(q, scenario.view.centers)] = 0
                A[:, j] += value
    area = np.linalg.norm(np.cross(scenario.hidden.across, scenario.hidden.up), axis=1)
    return A * scenario.view.reflectance.mean() / np.pi * area / (down * across)
