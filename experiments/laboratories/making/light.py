"""Light that reaches a wall straight from flat sources, by stratified shadow rays.

Plain Mitsuba and Dr.Jit, written apart from the package that is judged by it.
"""

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import drjit as dr
import mitsuba as mi
import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]

OFFSET = 1e-4
"""Metres that a ray starts above its surface, and ends before the source."""


@dataclass(frozen=True, eq=False)
class Source:
    """A flat source of light, and what it shows.

    Attributes
    ----------
    corner, across, up, normal
        (3,) the lower left corner as a viewer sees it, the edges to his right and up, metres, and
        the unit normal towards him.
    radiance
        (rows, columns, 3), row 0 at the top.
    """

    corner: Array
    across: Array
    up: Array
    normal: Array
    radiance: Array

    @property
    def area(self) -> float:
        """Square metres."""
        return float(np.linalg.norm(np.cross(self.across, self.up)))

    def table(self) -> Any:
        """Return the radiance of the patches, row by row, for `emitted`."""
        return mi.Color3f(np.ascontiguousarray(self.radiance.reshape(-1, 3).T, np.float32))

    def emitted(self, table: Any, u: Any, v: Any, point: Any) -> tuple[Any, Any, Any, Any]:
        """Return direction, distance, cosine at the source and radiance of its point (u, v)."""
        rows, columns = self.radiance.shape[:2]
        place = _vector(self.corner) + u * _vector(self.across) + v * _vector(self.up)
        offset = place - point
        distance = dr.norm(offset)
        direction = offset / distance
        cosine = dr.maximum(-dr.dot(direction, _vector(self.normal)), 0)
        row = rows - 1 - dr.minimum(mi.UInt32(v * rows), rows - 1)
        column = dr.minimum(mi.UInt32(u * columns), columns - 1)
        radiance = dr.gather(mi.Color3f, table, row * columns + column)
        return direction, distance, cosine, radiance


def source_of(shape: Any, radiance: Array) -> Source:
    """Return a source in the place of a Mitsuba rectangle, whose v runs up."""
    corner, right, top = (
        np.array(shape.eval_parameterization(mi.Point2f(u, v)).p).ravel().astype(float)
        for u, v in ((0, 0), (1, 0), (0, 1))
    )
    normal = np.array(shape.eval_parameterization(mi.Point2f(0.5, 0.5)).n).ravel().astype(float)
    return Source(corner, right - corner, top - corner, normal, radiance)


def direct_irradiance(
    scene: Any, points: Any, normal: Any, source: Source, strata: tuple[int, int], seed: int
) -> Array:
    """Return what a source sends to wall points straight, (n, 3), in radiance times steradians.

    Points and normals are Dr.Jit's. Each of the cells of the source, `strata` down and across, has
    one jittered ray. All of the scene blocks light.
    """
    table, (down, across) = source.table(), strata
    origin = points + OFFSET * normal

    def unfinished(cell: Any, rng: Any, total: Any) -> Any:  # noqa: ARG001
        return cell < down * across

    def add_cell(cell: Any, rng: Any, total: Any) -> Any:
        u = (mi.Float(cell % across) + rng.next_float32()) / across
        v = (mi.Float(cell // across) + rng.next_float32()) / down
        total += from_source(scene, origin, normal, source, table, u, v, mi.Bool(True))
        return cell + 1, rng, total

    rng = mi.PCG32(size=dr.width(points), initstate=mi.UInt64(seed))
    state = (mi.UInt32(0), rng, dr.zeros(mi.Color3f, dr.width(points)))
    total = dr.while_loop(state, unfinished, add_cell, labels=("cell", "rng", "total"))[2]
    total *= source.area / (down * across)
    return np.array(total, np.float64).T


def from_source(
    scene: Any, origin: Any, normal: Any, source: Source, table: Any, u: Any, v: Any, active: Any
) -> Any:
    """Return radiance times both cosines over the squared distance, 0 where something blocks."""
    direction, distance, cosine, radiance = source.emitted(table, u, v, origin)
    lit = dr.dot(direction, normal)
    active = active & (lit > 0) & (cosine > 0)
    ray = mi.Ray3f(origin, direction, distance - OFFSET, 0.0, [])
    active &= ~scene.ray_test(ray, active)
    return dr.select(active, radiance * (lit * cosine / dr.square(distance)), 0)


def sources_in(shapes: Sequence[Any]) -> list[Source]:
    """Return the room's lights: shapes whose ids begin with ``light_``."""
    found = []
    for shape in shapes:
        if shape.id().startswith("light_"):
            radiance = mi.traverse(shape)["emitter.radiance.value"]
            found.append(source_of(shape, np.array(radiance, float).reshape(1, 1, 3)))
    return found


def _vector(values: Array) -> Any:
    return mi.Vector3f(*(float(value) for value in values))
