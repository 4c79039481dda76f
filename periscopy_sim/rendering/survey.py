"""A scene as a surveyor sees it: where the camera's rays run, what hides the monitor."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from periscopy_sim.rendering.scene.load import build_scene, camera_of
from periscopy_sim.rendering.scene.pointwise import map_points
from periscopy_sim.rendering.transport.kernel import SHADOW_EPSILON
from periscopy_sim.rendering.variant import is_vectorized
from periscopy_sim.scenario import Array, Scenario

EDGE = 1e-4
"""Of the picture's size by which its corners are looked at within it; its size is told to 1e-3."""

PARALLEL = 1e-5
"""Differences of directions that rounding makes."""

SIDE = 24
"""Points along each side of a grid over a surface that is no mesh."""


@dataclass(frozen=True, eq=False)
class Solid:
    """A shape as points (n, 3), and triangles of them (F, 3); without these, their convex hull."""

    name: str
    points: Array
    faces: NDArray[np.int64] | None


class Survey:
    """The geometry of a scenario's scene, of which plans are drawn.

    Attributes
    ----------
    view_origins, view_points
        (5, 3) where the camera's rays through the picture's corners (top left, top right, bottom
        right, bottom left) and its middle come from, and where they meet the wall; metres.
    parallel
        Whether these rays are parallel; else they come from one point.
    monitor_points
        (N, 3) corners of the monitor's patches.
    solids
        What stands between, each shape but the wall and the monitor.
    """

    def __init__(self, scenario: Scenario) -> None:
        self._scene = build_scene(scenario)
        camera = camera_of(self._scene)
        corners = np.array([(0, 0), (1, 0), (1, 1), (0, 1), (0.5, 0.5)])
        film = EDGE + (1 - 2 * EDGE) * corners

        def through(position: Any) -> tuple[Any, Any, Any]:
            import mitsuba as mi

            ray, _ = camera.sample_ray(0.0, 0.0, position, mi.Point2f(0.5, 0.5))
            return ray.o, ray.d, self._scene.ray_intersect(ray).p

        origins, directions, self.view_points = map_points(through, film)
        self.parallel = bool(np.ptp(directions, axis=0).max() < PARALLEL)
        # Mitsuba's rays begin at the near clipping plane.
        eye = origins if self.parallel else _nearest_point(origins, directions)
        self.view_origins: Array = np.broadcast_to(eye, (5, 3))
        half_across, half_up = scenario.patch_across / 2, scenario.patch_up / 2
        self.monitor_points: Array = np.concatenate(
            [
                scenario.patch_centers + a * half_across + b * half_up
                for a in (-1, 1)
                for b in (-1, 1)
            ]
        )
        shapes = {shape.id(): shape for shape in self._scene.shapes()}
        self.solids = tuple(
            Solid(each.name, _surface(shapes[each.name]), None)
            if each.vertices is None
            else Solid(each.name, each.vertices, each.faces)
            for each in scenario.occluders
        )

    def lit_share(self, points: Array, targets: Array) -> Array:
        """Return the share of targets (k, 3) that nothing hides from each point (n, 3)."""
        starts = np.repeat(points, len(targets), axis=0)
        ends = np.tile(targets, (len(points), 1))
        lit: Array = np.mean(~self.blocked(starts, ends).reshape(len(points), -1), axis=1)
        return lit

    def blocked(self, starts: Array, ends: Array) -> NDArray[np.bool_]:
        """Return whether anything stands between points (n, 3) and others (n, 3)."""
        import mitsuba as mi

        path = ends - starts
        first = starts + SHADOW_EPSILON * path
        reach = 1 - 2 * SHADOW_EPSILON
        if is_vectorized():
            ray = mi.Ray3f(
                mi.Point3f(first.T.astype(np.float32)),
                mi.Vector3f(path.T.astype(np.float32)),
                reach,
                0.0,
                [],
            )
            return np.array(self._scene.ray_test(ray), bool)
        return np.array(
            [
                bool(self._scene.ray_test(mi.Ray3f(list(o), list(d), reach, 0.0, [])))
                for o, d in zip(first.tolist(), path.tolist(), strict=True)
            ]
        )


def _nearest_point(origins: Array, directions: Array) -> Array:
    """Return the point of least squared distance to lines of unit directions, both (n, 3)."""
    across = np.eye(3) - directions[:, :, None] * directions[:, None, :]
    moved = np.einsum("nij,nj->i", across, origins)
    return np.asarray(np.linalg.solve(across.sum(axis=0), moved))


def _surface(shape: Any) -> Array:
    """Return points all over a shape that is no mesh, or the corners of its box."""

    def sampled(position: Any) -> tuple[Any]:
        return (shape.sample_position(0.0, position).p,)

    side = np.linspace(0, 1 - 1e-6, SIDE)
    grid = np.stack(np.meshgrid(side, side), axis=2).reshape(-1, 2)
    try:
        points: Array = map_points(sampled, grid)[0]
    except (RuntimeError, NotImplementedError):
        points = np.full((1, 3), np.nan)
    if np.isfinite(points).all():
        return points
    box = shape.bbox()
    ends = np.array([np.ravel(box.min), np.ravel(box.max)], float)
    return np.array(np.meshgrid(*ends.T)).reshape(3, -1).T
