"""Functions of Mitsuba at many points, at once or one by one, and the points of a surface."""

from collections.abc import Callable
from typing import Any

import numpy as np

from periscopy_sim.rendering.variant import is_vectorized
from periscopy_sim.scenario import Array


def map_points(function: Callable[[Any], tuple[Any, ...]], points: Array) -> list[Array]:
    """Evaluate a function of a Point2f, that returns Dr.Jit numbers and vectors, at (n, 2) points.

    The result is an (n, components) float64 array for each of its values.
    """
    import drjit as dr
    import mitsuba as mi

    if is_vectorized():
        values = function(mi.Point2f(points.T.astype(np.float32)))
        dr.eval(*values)  # all in one kernel, where each component would be traced by its own
        return [_columns(value, len(points)) for value in values]
    each = [function(mi.Point2f(float(x), float(y))) for x, y in points]
    return [
        np.array([np.ravel(row) for row in rows], dtype=np.float64)
        for rows in zip(*each, strict=True)
    ]


def surface_at(shape: Any, uv: Any) -> Any:
    """Find the point of a shape at UV coordinates, Mitsuba's Point2f within the unit square.

    Mitsuba looks for it by a ray in the UV plane, which may slip between two triangles where it
    meets their edge; there a point beside it is taken. The interaction is not valid where the shape
    has no point. A shape without UV coordinates is a RuntimeError.
    """
    import drjit as dr
    import mitsuba as mi

    found = shape.eval_parameterization(uv, +mi.RayFlags.All)
    if not shape.is_mesh():
        return found
    beside = uv * (1 - 2e-5) + mi.Point2f(0.7e-5, 1.3e-5)
    missed = ~found.is_valid() if is_vectorized() else not found.is_valid()
    return dr.select(missed, shape.eval_parameterization(beside, +mi.RayFlags.All, missed), found)


def _columns(value: Any, count: int) -> Array:
    import drjit as dr

    components = value if dr.depth_v(value) > 1 else [value]
    # Components that are the same everywhere have length 1.
    return np.stack(
        [np.broadcast_to(np.array(c, dtype=np.float64), count) for c in components], axis=1
    )
