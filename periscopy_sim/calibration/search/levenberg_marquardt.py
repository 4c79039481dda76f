"""Levenberg and Marquardt's descent to the parameters that explain a photograph best."""

from __future__ import annotations

from contextlib import suppress
from dataclasses import dataclass, replace

import numpy as np

from periscopy_sim.calibration.explanation.evidence import Explanation
from periscopy_sim.calibration.explanation.resolution_level import ResolutionLevel, Values, Visit
from periscopy_sim.calibration.search.fisher_information import (
    UNSEEN,
    Curvature,
    block_scores,
    curvature,
    differences,
)
from periscopy_sim.calibration.search.physical_step import physical_step
from periscopy_sim.errors import SceneError

DAMPING = 1e-3
"""The first: part of the curvature that is added to it."""

NEGLIGIBLE_GAIN = 0.5
"""In evidence, predicted or made, that is not worth a step: of at most 0.7 standard errors."""

LONGER_STEP, LONGEST_STEP = 1.5, 4.0
"""Times a step, from which on it is worth an explanation to go so far, and at most."""

TRIALS = 5
"""Steps tried, each shorter, before a point is called the best."""

SEEDS = 3
"""Of an iteration: two of its differences, one of a test of its end."""


@dataclass(frozen=True, eq=False)
class Descent:
    """Where a descent ended: the best parameters, (P,), and what the photograph tells there."""

    values: Values
    explanation: Explanation
    curvature: Curvature
    unphysical: SceneError | None  # why it went no further, if the physical's border stopped it


def descend(
    level: ResolutionLevel,
    start: Values,
    steps: Values,
    longest: Values,
    iterations: int,
    visit: Visit,
) -> tuple[ResolutionLevel, Descent]:
    """Walk downhill from a start, (P,), until nothing is gained; each is passed to `visit`.

    Derivatives are taken by moves of `steps`, (P,), to either side, see `differences`. A step goes
    no farther than `longest`, (P,), before it is extended; parameters that it would take past what
    is physical go a part of it. Each iteration has rays of its own: a place that was chosen by some
    rays looks better by them than it is. It begins with the gain over the wall and the discrepancy
    that are found there: a misplaced scene leaves a structured one, which goes as the scene finds
    its place. Steps are taken by what is found where they lead, see `ResolutionLevel.judged`.
    Returned is also the level, of the rays given, that has the last discrepancy. A SceneError is
    raised if the start is not physical.
    """
    values, damping, gain, unphysical = start, DAMPING, np.inf, None
    for iteration in range(iterations + 1):
        drawn, here, about = _looked(level.reseeded(level.seed + SEEDS * iteration), values, steps)
        if not iteration:
            visit(values, here.evidence)
        if iteration == iterations or min(gain, about.predicted_gain) < NEGLIGIBLE_GAIN:
            break
        gain, unphysical = 0.0, None
        for trial in range(TRIALS):
            step, error = _physical_step(drawn, about, values, damping, longest)
            unphysical = error if trial == 0 else unphysical
            try:
                tried = drawn.judged(values + step)
            except SceneError as refused:
                unphysical = refused if trial == 0 else unphysical
            else:
                if tried.evidence < here.evidence:
                    if trial == 0:
                        rate = 2 * float(about.slope @ step)
                        step, tried = _extended(drawn, values, step, rate, here, tried)
                    gain = here.evidence - tried.evidence
                    values = values + step
                    visit(values, tried.evidence)
                    damping /= 5
                    break
            damping = max(damping, DAMPING) * 10
        else:
            break
        level = drawn.gained(tried).reseeded(level.seed)
    ended = drawn.reseeded(level.seed)
    return ended, Descent(values, here, about, unphysical if gain < NEGLIGIBLE_GAIN else None)


def _physical_step(
    level: ResolutionLevel, about: Curvature, values: Values, damping: float, longest: Values
) -> tuple[Values, SceneError | None]:
    """Return Newton's step, or what of it is physical, and the error; see `physical_step`."""
    return physical_step(
        level,
        values,
        about.step(damping, longest),
        lambda free: about.of(free).step(damping, longest[free]),
    )


def _looked(
    level: ResolutionLevel, values: Values, steps: Values
) -> tuple[ResolutionLevel, Explanation, Curvature]:
    """Return a level for the discrepancy that some values leave, and what is seen there by it."""
    level, A = level.as_it_comes(), level.matrix(values)
    changes = differences(level, values, np.diag(steps))
    found = level.explained_by(A, values)
    rough = curvature(level, values, found, changes)
    level = level.compared(found, rough.left_of).whitened(found)
    white = level.explained_by(A, values)
    about = curvature(level, values, white, changes)
    # What the parameters can still explain is no overdispersion, nor was it discrepancy.
    left = about.left_of(white.residuals / white.deviations) * white.deviations
    beyond = replace(white, residuals=left)
    overdispersion = about.overdispersion(block_scores(level, beyond, about.jacobian))
    level = level.overdispersed(overdispersion).levered(white, A)
    return level, level.explained_by(A, values, white.fit), about.tempered(overdispersion)


def _extended(
    level: ResolutionLevel,
    values: Values,
    step: Values,
    rate: float,
    here: Explanation,
    there: Explanation,
) -> tuple[Values, Explanation]:
    """Return a step as long as the parabola through either end is deep, and what is seen there.

    It leaves `here` at a rate, the derivative of the evidence. Along a valley that shadows' edges
    make rough, the information near a point is more than that over the valley, and steps come out
    short.
    """
    bend = there.evidence - here.evidence - rate
    part = min(-rate / (2 * bend), LONGEST_STEP) if bend > 0 else LONGEST_STEP
    if part > LONGER_STEP:
        with suppress(SceneError):
            farther = level.judged(values + part * step)
            if farther.evidence < there.evidence:
                return part * step, farther
    return step, there


def settle(level: ResolutionLevel, end: Descent, longest: Values) -> tuple[Values, Explanation]:
    """Take the step, at most `longest`, that a descent's end still asks for, if that gains.

    Where there are rays, others must agree.

    Between places so near, the evidence by the descent's own rays tells more of the rays than of
    the places; its slope, of wide differences and of two sets of rays, does not. Returned are the
    values and explanation there; those of the descent's end where rays that chose neither place
    find that one better, or the step is not physical. Either explanation is by the level's own
    rays, as those of other places are with which it is compared: by others the evidence of one
    place differs by far more than that of places beside each other by the same.
    """
    step, _ = _physical_step(level, end.curvature, end.values, UNSEEN, longest)
    there, other = end.values + step, level.seed + 2
    here = level.judged(end.values)
    try:
        reached = level.judged(there)
        if level.by_area:
            better = reached.evidence < here.evidence
        else:
            by_others = (level.judged(at, other).evidence for at in (there, end.values))
            better = next(by_others) < next(by_others)
    except SceneError:
        better = False
    return (there, reached) if better else (end.values, here)
