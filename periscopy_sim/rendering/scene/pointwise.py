"""Functions of Mitsuba at many points: at once where the variant vectorizes, else one by one."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import numpy as np

from periscopy_sim.rendering.variant import is_vectorized
from periscopy_sim.scenario import Array


def map_points(function: Callable[[Any], tuple[Any, ...]], points: Array) -> list[Array]:
    """Evaluate a function of a Point2f at many points.

    Parameters
    ----------
    function
        It returns Dr.Jit numbers and vectors.
    points
        (n, 2) points.

    Returns
    -------
    list of ndarray
        (n, components) float64 for each of its values.
    """
    import mitsuba as mi

    if is_vectorized():
        values = function(mi.Point2f(points.T.astype(np.float32)))
        return [_columns(value, len(points)) for value in values]
    each = [function(mi.Point2f(float(x), float(y))) for x, y in points]
    return [
        np.array([np.ravel(row) for row in rows], dtype=np.float64)
        for rows in zip(*each, strict=True)
    ]


def _columns(value: Any, count: int) -> Array:
    import drjit as dr

    components = value if dr.depth_v(value) > 1 else [value]
    # Components that are the same everywhere have length 1.
    return np.stack(
        [np.broadcast_to(np.array(c, dtype=np.float64), count) for c in components], axis=1
    )
