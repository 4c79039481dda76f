"""Steps that end where the physical does: of a box at size 0, of an exponent at 0."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
from numpy.typing import NDArray

from periscopy_sim.calibration.explanation.resolution_level import ResolutionLevel, Values
from periscopy_sim.errors import SceneError

PARTS = 0.25, 0.0625
"""Of a step that are tried towards the border of what is physical."""


def physical_step(
    level: ResolutionLevel,
    values: Values,
    step: Values,
    step_of: Callable[[NDArray[np.bool_]], Values],
) -> tuple[Values, SceneError | None]:
    """Return a step from some values, and why it is not physical; then as much of it as is.

    Parameters that it takes past the border by themselves go a part of the way, the others by the
    step that `step_of` returns of them, (P,) booleans, alone: an exponent that a ruler has near 0
    must not hold up all.
    """
    error = level.unphysical(values + step)
    if error is None:
        return step, None
    moves = np.diag(step)
    free = np.array([level.unphysical(values + move) is None for move in moves])
    if free.all() or not free.any():
        return step, error
    found = np.zeros_like(step)
    found[free] = step_of(free)
    for move in moves[~free]:
        parts = (part for part in PARTS if level.unphysical(values + part * move) is None)
        found += next(parts, 0.0) * move
    return found, error
