"""Descents, each to where the image lies within a patch, and walks to places patches away."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from periscopy_sim.calibration.explanation.evidence import Explanation
from periscopy_sim.calibration.explanation.resolution_level import ResolutionLevel, Values, Visit
from periscopy_sim.calibration.search.fisher_information import Curvature
from periscopy_sim.calibration.search.image_shift import (
    BETWEEN_PATCHES,
    NEGLIGIBLE,
    ImageShift,
    between_patches,
)
from periscopy_sim.calibration.search.image_warp import undone
from periscopy_sim.calibration.search.levenberg_marquardt import Descent, descend, settle
from periscopy_sim.calibration.search.patch_walk import Walked, walk
from periscopy_sim.calibration.search.telling import least_gain
from periscopy_sim.errors import SceneError
from periscopy_sim.scenario import Array

ITERATIONS = 10
"""Of a descent, at most; the last of them gain little and take long."""

BESIDE, FEW = 4, 1
"""Dips beside a walk's end from which descents try to gain on it, and their iterations; one that
gains goes on to the bottom."""

WALKS = 6
"""From patch to patch, or to a dip beside, after which a descent follows, at most; the last one has
none."""


@dataclass(frozen=True, eq=False)
class Best:
    """The best parameters, (P,), what is seen there, and what tells how well they are known."""

    values: Values
    seen: Explanation
    level: ResolutionLevel  # with the discrepancy of the last descent
    end: Descent
    alike: Array  # (P, K) how far it is to where the photograph looks much the same, see `walk`


def search_patches(
    level: ResolutionLevel,
    start: Values,
    steps: Values,
    shift: ImageShift,
    visit: Visit,
    looked: Callable[[], None],
    wider: int = 1,
) -> Best:
    """Find the best parameters about a start, (P,): descend and walk by turns until neither gains.

    Where a walk stays, descents from the dips beside it try. Where a later descent is stopped by
    the border of the physical, what was found before is kept. All that descents reach, of those
    from dips beside too, is passed to `visit`; `looked` is called for each place that a walk
    looks at, `wider` times as many as usual. Steps are those of `descend`. A SceneError says that
    the start is not physical.
    """
    # A row or a column of patches has no place beside it.
    by_patch = shift.by_patch * (np.array(level.hidden_shape[::-1]) > 1)
    values, best = start, None
    for walked in range(WALKS + 1):
        level, end, here = _descended(level, values, steps, shift, visit)
        moves, _ = undone(end.explanation, end.curvature, level.hidden_shape, ~shift.alone)
        if best is not None and end.unphysical is not None and best.end.unphysical is None:
            return best
        found = walk(level, end, *here, np.hstack([moves, by_patch]), looked, wider)
        best = Best(found.values, found.seen, level, end, found.alike)
        values = found.values
        if walked == WALKS:
            break
        if np.array_equal(values, here[0]):
            better = _beside(level, end.curvature, found, steps, visit, looked)
            if better is None:
                break
            values = better
    assert best is not None
    return best


def _beside(
    level: ResolutionLevel,
    about: Curvature,
    found: Walked,
    steps: Values,
    visit: Visit,
    looked: Callable[[], None],
) -> Values | None:
    """Return where a descent from a dip beside gains more than the `least_gain`; None if none does.

    A walk's chords have the derivatives of the dip that it came from, so that they do not come to
    the bottom of one that is not much alike.
    """

    def gain(at: Values, seed: int) -> float:
        here, there = (
            between_patches(level, place, level.judged(place, seed)) for place in (found.values, at)
        )
        return here - there

    def is_better(end: Descent) -> bool:
        """Return whether the photograph tells, by rays too that did not choose the place."""
        places = ((at, level.explain(at)) for at in (found.values, end.values))
        least = least_gain(level, about, *places)
        seeds = (level.seed,) if level.by_area else (level.seed, level.seed + 2)
        return end.unphysical is None and all(gain(end.values, seed) > least for seed in seeds)

    for dip in found.beside[:BESIDE]:
        looked()
        try:
            _, end = descend(level, dip, steps, 5 * steps, FEW, visit)
            if not gain(end.values, level.seed) > BETWEEN_PATCHES * NEGLIGIBLE:
                continue
            _, end = descend(level, end.values, steps, 5 * steps, ITERATIONS, visit)
            if is_better(end):
                return end.values
        except SceneError:
            continue
    return None


def _descended(
    level: ResolutionLevel, start: Values, steps: Values, shift: ImageShift, visit: Visit
) -> tuple[ResolutionLevel, Descent, tuple[Values, Explanation]]:
    """Descend, and once more from where the ruler has the image, if that is whole patches away.

    The photograph looks nearly the same there, but its perspective is another: all parameters have
    to follow. Where they would have to leave the physical, they stay.
    """
    level, end = descend(level, start, steps, 5 * steps, ITERATIONS, visit)
    here = settle(level, end, steps)
    nearest = shift.settled(level, *here)
    if np.array_equal(nearest[0], here[0]):
        return level, end, here
    try:
        followed, again = descend(level, nearest[0], steps, 5 * steps, ITERATIONS, visit)
    except SceneError:
        return level, end, nearest
    if again.unphysical is not None:
        return level, end, nearest
    return followed, again, settle(followed, again, steps)
