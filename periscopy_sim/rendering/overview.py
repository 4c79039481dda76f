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

ANGLE = 32.0
"""Degrees of the picture's width."""

AZIMUTHS = (35, -35, 55, -55, 75, -75, 15, -15, 90, -90, 0, 120, -120, 150, -150, 180)
HEIGHTS = (30, 45, 15, 65)
"""Degrees about the vertical, from looking at the wall, and downwards; the first are preferred."""

FAR = 100.0
"""Metres within which everything lies."""

GRAZING, EDGE_ON = 0.35, 0.5
"""Cosine below which a surface is seen edge-on, and how many landmarks, as a share, that costs."""

MARGIN = 1.12
"""Of the picture, about all that it shows."""

ROOM_LIGHT = 0.25
"""Of the wall's brightest part by the monitor's light: light from all around, to see by."""


@dataclass(frozen=True, eq=False)
class View:
    """A pinhole camera of square pixels: its place, its axes (right, up, ahead), its half width.

    The half width is the tangent of half of the angle that the picture's width spans.
    """

    origin: Array
    axes: Array
    half_width: float
    shape: tuple[int, int]

    def project(self, points: Array) -> tuple[Array, NDArray[np.bool_]]:
        """Return (n, 2) columns and rows of points (n, 3), and whether they lie before the camera.

        The first pixel's centre is at (0.5, 0.5).
        """
        right, up, ahead = ((points - self.origin) @ self.axes.T).T
        rows, columns = self.shape
        before = ahead > 1e-6
        scale = columns / 2 / self.half_width / np.where(before, ahead, 1.0)
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
    edge_on = [
        sum(_cosine(view.origin - point, normal) < GRAZING for point, normal in surfaces)
        for view in views
    ]
    return views[int(np.argmin(hidden.mean(axis=1) + EDGE_ON * np.array(edge_on)))]


def _cosine(a: Array, b: Array) -> float:
    """Return the cosine of the angle between a line along a and one along b."""
    return float(abs(a @ b) / np.linalg.norm(a) / np.linalg.norm(b))


def _around(
    points: Array, azimuth: float, height: float, shape: tuple[int, int], towards: Array
) -> View:
    """Return a view in a direction that just holds all points, with a margin."""
    forth = np.array([towards[0], towards[1], 0.0])
    forth /= np.linalg.norm(forth)
    side = np.array([forth[1], -forth[0], 0.0])
    a, h = np.radians([azimuth, height])
    ahead = np.cos(h) * (np.cos(a) * forth - np.sin(a) * side) - np.sin(h) * np.array([0, 0, 1.0])
    right = np.cross(ahead, [0.0, 0.0, 1.0])
    right /= np.linalg.norm(right)
    axes = np.stack([right, np.cross(right, ahead), ahead])
    half = np.array([1.0, shape[0] / shape[1]]) * np.tan(np.radians(ANGLE / 2))
    local = points @ axes.T
    # Of the planes through the eye that bound the picture, each touches the points.
    slack = half / MARGIN
    low = (local[:, :2] + local[:, 2:] * slack).min(axis=0)
    high = (local[:, :2] - local[:, 2:] * slack).max(axis=0)
    depth = float(np.min((low - high) / (2 * slack)))
    eye = np.array([*(low + high) / 2, 0.0])
    eye[2] = depth
    return View(eye @ axes, axes, float(half[0]), shape)


def render_overview(
    scenario: Scenario, view: View, *, samples: int = 64, seed: int = 0
) -> NDArray[np.float64]:
    """Return a path-traced picture of a scene, (rows, columns, 3) radiance, by an even room light.

    The monitor is white, and without its falloff where only a scalar
    variant works.
    """
    import mitsuba as mi

    scene = build_scene(scenario, plain_emitter=not is_vectorized())
    origin, (_, up, ahead) = view.origin, view.axes
    rows, columns = view.shape
    sensor = mi.load_dict(
        {
            "type": "perspective",
            "fov": float(2 * np.degrees(np.arctan(view.half_width))),
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
    shapes = {f"shape{k}": shape for k, shape in enumerate(scene.shapes())}
    light = {"type": "constant", "radiance": {"type": "rgb", "value": _room_light(scenario)}}
    lit = mi.load_dict({"type": "scene", "light": light, **shapes})
    return path_trace(lit, 4, samples=samples, seed=seed, sensor=sensor)


def covered(survey: Survey, view: View) -> Array:
    """Return how much of each pixel of a view shows anything, (rows, columns), of 2 x 2 points."""
    rows, columns = (2 * n for n in view.shape)
    row, column = np.divmod(np.arange(rows * columns), columns)
    right = view.half_width * ((column + 0.5) / columns * 2 - 1)
    up = view.half_width * (rows - 2 * (row + 0.5)) / columns
    rays = np.stack([right, up, np.ones(len(row))], axis=1) @ view.axes
    eye = np.tile(view.origin, (len(rays), 1))
    blocked = survey.blocked(eye, eye + FAR * rays)
    grid = blocked.reshape(view.shape[0], 2, view.shape[1], 2)
    return np.asarray(grid.mean(axis=(1, 3)))


def _room_light(scenario: Scenario) -> float:
    """Return a radiance from all around by which wall and monitor are both seen."""
    distance = scenario.wall_points.mean(axis=0) - scenario.patch_centers.mean(axis=0)
    return ROOM_LIGHT * float(scenario.patch_areas.sum() / (np.pi * distance @ distance))
