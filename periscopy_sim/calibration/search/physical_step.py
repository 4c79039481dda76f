"""Steps that stop at the border of what is physical: a box of size 0, an exponent of 0."""

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
    """Return a step as it is, and None, if it is physical; else what can be taken, and the error.

    Parameters that cross the border go a part of the way: an exponent that a ruler has near 0 must
    not hold up all. For the others `step_of`, given which they are as (P,) booleans, returns the
    step. Where none crosses it alone, or all do, the step is returned as it is. What is returned
    may still not be physical: callers try it.
    """
    error = level.unphysical(values + step)
    if error is None:
        return step, None
    held = _beyond(level, values, step, np.arange(len(step)), known=True)
    if not held or len(held) == len(step):
        return step, error
    free = np.ones(len(step), bool)
    free[held] = False
    found = np.zeros_like(step)
    found[free] = step_of(free)
    for k in held:
        move = _alone(step, [k])
        parts = (part for part in PARTS if level.unphysical(values + part * move) is None)
        found += next(parts, 0.0) * move
    return found, error


def _beyond(
    level: ResolutionLevel,
    values: Values,
    step: Values,
    some: NDArray[np.intp],
    known: bool = False,
) -> list[int]:
    """Return which of some parameters a step takes past the border, all together if it is `known`.

    Halves are tried together, for a scene takes a while to load; none of one that is physical
    counts.
    """
    if not known and level.unphysical(values + _alone(step, some)) is None:
        return []
    if len(some) == 1:
        return [int(some[0])]
    return [k for half in np.array_split(some, 2) for k in _beyond(level, values, step, half)]


def _alone(step: Values, some: NDArray[np.intp] | list[int]) -> Values:
    """Return a step of some parameters alone."""
    alone = np.zeros_like(step)
    alone[some] = step[some]
    return alone
