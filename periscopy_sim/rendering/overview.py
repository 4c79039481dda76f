"""A small picture of a whole laboratory, from a place from which everything is seen."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from periscopy_sim.rendering.photograph import path_trace
from periscopy_sim.rendering.scene.load import build_scene
from periscopy_sim.rendering.survey import Survey
from periscopy_sim.rendering.variant import is_vectorized
from periscopy_sim.scenario import Array, Scenario

HALF_WIDTH = 0.287
"""Tangent of half the angle that the picture's width spans: 32 degrees."""

AZIMUTHS = (35, -35, 55, -55, 75, -75, 15, -15, 90, -90, 0, 120, -120, 180)
HEIGHTS = (30, 45, 15)
"""Degrees about the vertical, from looking at the wall, and downwards; the first are preferred."""

EDGE_ON = 0.35
"""Cosine below which wall and monitor are seen edge-on."""

MARGIN = 1.12
"""Width of the picture over that of all that it shows."""

ROOM_LIGHT = 0.25
"""Light from all around, to see by, over what the monitor sends to the wall."""


@dataclass(frozen=True, eq=False)
class View:
    """A pinhole camera of square pixels: its place, its axes (right, up, ahead), its size."""

    origin: Array
    axes: Array
    shape: tuple[int, int]

    def project(self, points: Array) -> tuple[Array, NDArray[np.bool_]]:
        """Return (n, 2) columns and rows of points (n, 3), and whether they lie before the camera.

        The first pixel's centre is at (0.5, 0.5).
        """
        right, up, ahead = ((points - self.origin) @ self.axes.T).T
        rows, columns = self.shape
        before = ahead > 1e-6
        scale = columns / 2 / HALF_WIDTH / np.where(before, ahead, 1.0)
        return np.stack([columns / 2 + right * scale, rows / 2 - up * scale], axis=1), before


def find_view(
    survey: Survey,
    points: Array,
    landmarks: Array,
    surfaces: Sequence[tuple[Array, Array]],
    shape: tuple[int, int],
    towards: Array,
) -> View:
    """Return the view in which all points (n, 3) lie and most landmarks (k, 3) are seen.

    Surfaces, each a point and its normal, are best not seen edge-on. `towards` is the horizontal
    direction in which the wall is faced; the picture's shape is (rows, columns).
    """
    views = [
        _around(points, azimuth, height, shape, towards)
        for height in HEIGHTS
        for azimuth in AZIMUTHS
    ]
    eyes = np.repeat([view.origin for view in views], len(landmarks), axis=0)
    hidden = survey.blocked(eyes, np.tile(landmarks, (len(views), 1))).reshape(len(views), -1)
    away = np.array([[view.origin - point for point, _ in surfaces] for view in views])
    normals = np.array([normal / np.linalg.norm(normal) for _, normal in surfaces])
    cosine = np.abs(np.sum(away * normals, axis=2)) / np.linalg.norm(away, axis=2)
    edge_on = np.sum(cosine < EDGE_ON, axis=1)
    return views[int(np.argmin(hidden.mean(axis=1) + edge_on / 2))]


def _around(
    points: Array, azimuth: float, height: float, shape: tuple[int, int], towards: Array
) -> View:
    """Return a view in a direction that just holds all points, with a margin."""
    forth = np.array([towards[0], towards[1], 0.0]) / np.hypot(towards[0], towards[1])
    side = np.array([forth[1], -forth[0], 0.0])
    a, h = np.radians([azimuth, height])
    flat = np.cos(a) * forth - np.sin(a) * side
    right = np.sin(a) * forth + np.cos(a) * side
    ahead = np.cos(h) * flat - np.sin(h) * np.array([0, 0, 1.0])
    axes = np.stack([right, np.cross(right, ahead), ahead])
    local = points @ axes.T
    # Of the planes through the eye that bound the picture, each touches the points.
    slack = HALF_WIDTH / MARGIN * np.array([1.0, shape[0] / shape[1]])
    low = (local[:, :2] + local[:, 2:] * slack).min(axis=0)
    high = (local[:, :2] - local[:, 2:] * slack).max(axis=0)
    eye = np.array([*(low + high) / 2, np.min((low - high) / (2 * slack))])
    return View(eye @ axes, axes, shape)


def render_overview(
    scenario: Scenario, view: View, *, samples: int = 64, seed: int = 0
) -> NDArray[np.float64]:
    """Return a path-traced picture of a scene, (rows, columns, 3) radiance, by an even room light.

    The monitor is white, and without its falloff where only a scalar variant works.
    """
    import mitsuba as mi

    scene = build_scene(scenario, plain_emitter=not is_vectorized())
    origin, (_, up, ahead) = view.origin, view.axes
    rows, columns = view.shape
    sensor = mi.load_dict(
        {
            "type": "perspective",
            "fov": float(2 * np.degrees(np.arctan(HALF_WIDTH))),
            "fov_axis": "x",
            "to_world": mi.ScalarTransform4f().look_at(
                origin.tolist(), (origin + ahead).tolist(), up.tolist()
            ),
            "film": {
                "type": "hdrfilm", "height": rows, "width": columns, "rfilter": {"type": "box"},
            },
            "sampler": {"type": "multijitter"},
        }
    )  # fmt: skip
    distance = scenario.wall_points.mean(axis=0) - scenario.patch_centers.mean(axis=0)
    radiance = ROOM_LIGHT * float(scenario.patch_areas.sum() / (np.pi * distance @ distance))
    light = {"type": "constant", "radiance": {"type": "rgb", "value": radiance}}
    shapes = {f"shape{k}": shape for k, shape in enumerate(scene.shapes())}
    lit = mi.load_dict({"type": "scene", "light": light, **shapes})
    return path_trace(lit, 4, samples=samples, seed=seed, sensor=sensor)


def covered(survey: Survey, view: View) -> Array:
    """Return how much of each pixel of a view shows anything, (rows, columns), of 2 x 2 points."""
    rows, columns = (2 * n for n in view.shape)
    row, column = np.divmod(np.arange(rows * columns), columns)
    right = HALF_WIDTH * ((column + 0.5) / columns * 2 - 1)
    up = HALF_WIDTH * (rows - 2 * (row + 0.5)) / columns
    rays = np.stack([right, up, np.ones(len(row))], axis=1) @ view.axes
    eye = np.tile(view.origin, (len(rays), 1))
    blocked = survey.blocked(eye, eye + 100 * rays)  # all lies within a hundred metres
    return np.asarray(blocked.reshape(view.shape[0], 2, view.shape[1], 2).mean(axis=(1, 3)))
