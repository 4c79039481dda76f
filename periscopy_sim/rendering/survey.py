"""A scene as a surveyor sees it: where the camera's rays run, what hides the monitor, how much."""

from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from periscopy_sim.numerics import Array
from periscopy_sim.rendering import shadow_rays, variant, wall
from periscopy_sim.scene import Occluder, corners
from periscopy_sim.view import Geometry

RAYS = 1 << 16
"""Rays between random places of the monitor and of the wall that `hidden_fraction` traces."""


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
    corners
        (R + 1, C + 1, 3) corners of the patches of each hidden surface, by its id.
    solids
        Each shape but the wall that the camera sees and the monitor.
    """

    def __init__(self, scenario: Geometry) -> None:
        source, view = scenario.scene.source, scenario.view
        self._scene, self._opaque = source.built(scenario.scene), source.opaque(scenario.scene)
        camera = wall.camera_of(self._scene, view.camera)
        film = np.array([(0, 0), (1, 0), (1, 1), (0, 1), (0.5, 0.5)])
        film = np.clip(
            film, shadow_rays.SHADOW_EPSILON, 1 - shadow_rays.SHADOW_EPSILON
        )  # rounding leaves none outside

        def through(position: Any) -> tuple[Any, Any, Any]:
            ray, si = wall.look(self._scene, camera, position)
            return ray.o, ray.d, si.p

        origins, directions, self.view_points = wall.map_points(through, film)
        self.parallel = np.allclose(directions, directions[0], atol=1e-5)
        eye = view.scene.places[view.camera][:3, 3]  # rays begin at the near clipping plane
        self.view_origins: Array = origins if self.parallel else np.tile(eye, (5, 1))
        self.corners = {name: surface.vertices for name, surface in scenario.hidden.items()}
        shapes = {shape.id(): shape for shape in self._scene.shapes()}
        self._shapes, self.names = shapes, tuple(shapes)
        self.solids = tuple(
            Solid(each.name, _points_of(each, shapes[each.name]), each.faces)
            for each in view.occluders
        )

    def lit_share(self, points: Array, targets: Array) -> Array:
        """Return the share of targets (k, 3) that nothing hides from each point (n, 3)."""
        starts = np.repeat(points, len(targets), axis=0)
        ends = np.tile(targets, (len(points), 1))
        return np.asarray(np.mean(~self.blocked(starts, ends).reshape(len(points), -1), axis=1))

    def blocked(self, starts: Array, ends: Array) -> NDArray[np.bool_]:
        """Return whether anything stands between points (n, 3) and others (n, 3)."""

        def test(start: Any, path: Any) -> tuple[Any]:
            ray = variant.mi.Ray3f(start, path, 1 - 2 * shadow_rays.SHADOW_EPSILON, 0.0, [])
            return (self._opaque.ray_test(ray),)

        path = ends - starts
        (met,) = wall.map_points(test, starts + shadow_rays.SHADOW_EPSILON * path, path)
        return np.asarray(met[:, 0] != 0)

    def seen(self, eyes: Array, directions: Array) -> tuple[NDArray[np.intp], Array, Array, Array]:
        """Return what rays from points, (n, 3) each, meet first.

        The numbers in `names` of the shapes, (n,), -1 of none; there the points and their normals,
        (n, 3) each, and u and v, (n, 2).
        """

        def meet(eye: Any, way: Any) -> tuple[Any, ...]:
            si = self._scene.ray_intersect(variant.mi.Ray3f(eye, variant.mi.Vector3f(way)))
            number = variant.mi.Float(-1)
            for k, shape in enumerate(self._shapes.values()):
                same = wall.is_shape(si, shape)
                number = variant.dr.select(same, variant.mi.Float(k), number)
            return number, si.p, si.n, si.uv

        number, points, normals, uv = wall.map_points(meet, eyes, directions)
        return number[:, 0].astype(np.intp), points, normals, uv


def _points_of(occluder: Occluder, shape: Any) -> Array:
    """Return a mesh's vertices, points all over another shape, or the corners of its box."""
    if occluder.vertices is not None:
        return occluder.vertices
    side = np.linspace(0, 1 - 1e-6, 24)
    grid = np.stack(np.meshgrid(side, side), axis=2).reshape(-1, 2)
    try:
        (points,) = wall.map_points(lambda sample: (shape.sample_position(0.0, sample).p,), grid)
    except (RuntimeError, NotImplementedError):
        points = np.full((1, 3), np.nan)
    assert occluder.bounds is not None
    return points if np.isfinite(points).all() else corners(occluder.bounds)


def hidden_fraction(scenario: Geometry) -> float:
    """Return the fraction of light paths from the monitor to the visible wall that are blocked."""
    rng = np.random.default_rng(0)
    pixel, patch = (rng.integers(size, size=RAYS) for size in scenario.transport_shape)
    across, up = rng.uniform(-0.5, 0.5, (2, RAYS, 1))
    hidden = scenario.hidden
    places = hidden.centers[patch] + across * hidden.across[patch] + up * hidden.up[patch]
    return float(np.mean(Survey(scenario).blocked(scenario.view.centers[pixel], places)))


def shadow_doubt(scenario: Geometry) -> str:
    """Return a warning where no occluder casts a shadow, or all is in shadow; empty otherwise."""
    hidden = hidden_fraction(scenario)
    if hidden == 1:
        return "occluders hide all of the monitor from what the camera sees of the wall"
    if hidden > 0:
        return ""
    names = ", ".join(f"'{occluder.name}'" for occluder in scenario.view.occluders[:3])
    return (
        "no occluder casts a shadow of the monitor into what the camera sees of the wall "
        f"({names or 'the scene has none'}): check their places, and that their numbers are metres"
    )
