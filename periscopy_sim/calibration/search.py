"""The search for a point that explains a photograph best: draws from the prior, and descents."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from periscopy_sim.calibration.evidence import Explanation
from periscopy_sim.calibration.information import Curvature
from periscopy_sim.calibration.level import ResolutionLevel
from periscopy_sim.errors import SceneError

Array = NDArray[np.float64]
Visit = Callable[[Array, float], None]

DAMPING = 1e-3
"""The first of a descent: fraction of the information that is added to it."""

NEGLIGIBLE_GAIN = 0.5
"""In evidence, predicted or made, that is not worth a step: of at most 0.7 standard errors."""

TRIALS = 5
"""Steps tried, each shorter, before a point is called the best."""

DOUBLINGS = 4
"""Of a step that gains, at most."""

LONGEST = 5.0
"""Of a step, in the steps of the parameters."""

LONGEST_GAIN = 0.2
"""Of a step in a coefficient of the gain over the wall."""

BOX = 3.0
"""Errors of the ruler beyond which nothing is drawn."""

DRAWS = 256
"""Places drawn at most: those that are not physical are passed over."""


@dataclass(frozen=True, eq=False)
class Descent:
    """Where a descent ended: the point, (P + K,), and what the photograph tells there.

    `unphysical` is why it went no further, if the border of the physical stopped it.
    """

    level: ResolutionLevel
    point: Array
    explanation: Explanation
    curvature: Curvature
    unphysical: SceneError | None


def descend(
    level: ResolutionLevel, start: Array, steps: Array, iterations: int, visit: Visit
) -> Descent:
    """Descend from a point by Levenberg and Marquardt's method until nothing is gained.

    A step goes no farther than `LONGEST` times `steps`, (P,), in the parameters. Each iteration
    makes the errors white that are left where it begins: a misplaced scene leaves structured ones,
    which go as the scene finds its place. Steps are judged by what they leave, see
    `ResolutionLevel.judge`. A SceneError says that the start is not physical.
    """
    point, damping, gain = start, DAMPING, np.inf
    longest = np.append(LONGEST * steps, np.full(len(start) - len(steps), LONGEST_GAIN))
    unphysical: SceneError | None = None
    for iteration in range(iterations + 1):
        level, here, about = level.look(point)
        if not iteration:
            visit(point, here.evidence)
        if iteration == iterations or min(gain, about.predicted_gain) < NEGLIGIBLE_GAIN:
            break
        gain, unphysical = 0.0, None
        for trial in range(TRIALS):
            try:
                step = _physical_step(level, about, point, damping, longest)
                tried = level.judge(point + step).evidence
            except SceneError as error:
                unphysical = error if trial == 0 else unphysical
            else:
                if tried < here.evidence:
                    step, tried = _extended(level, point, step, tried)
                    gain, point, damping = here.evidence - tried, point + step, damping / 5
                    visit(point, tried)
                    break
            damping = max(damping, DAMPING) * 10
        else:
            break
    return Descent(level, point, here, about, unphysical if gain < NEGLIGIBLE_GAIN else None)


def _extended(
    level: ResolutionLevel, point: Array, step: Array, evidence: float
) -> tuple[Array, float]:
    """Return a step that gains, doubled as long as that gains more, and the evidence there.

    Valleys of the evidence are rough: the information near a point is more than that over the
    valley, and steps come out short.
    """
    for _ in range(DOUBLINGS):
        farther = level.judgement(point + 2 * step)
        if not farther < evidence:
            break
        step, evidence = 2 * step, farther
    return step, evidence


def _physical_step(
    level: ResolutionLevel, about: Curvature, point: Array, damping: float, longest: Array
) -> Array:
    """Return Newton's step; parameters that alone would cross the border of the physical stay.

    An exponent that a ruler has near 0 must not hold up all others.
    """
    free = np.ones(len(point), bool)
    step = about.step(damping, longest, free)
    if level.is_physical(point + step):
        return step
    for k in range(len(level.matrices.names)):
        alone = np.zeros_like(step)
        alone[k] = step[k]
        free[k] = level.is_physical(point + alone)
    return about.step(damping, longest, free)


def places(
    level: ResolutionLevel, start: Array, widths: Array, count: int, seed: int
) -> list[Array]:
    """Return points about a start, (P + K,), the best first: draws from a normal distribution.

    The deviations of the parameters are `widths`, (P,); the draws are Sobol's sequence, so many of
    the physical ones. They have no gain over the wall.
    """
    from scipy.stats import norm, qmc

    even = qmc.Sobol(len(widths), rng=np.random.default_rng(seed)).random(DRAWS)
    values = level.values(start) + widths * np.clip(norm.ppf(even), -BOX, BOX)
    judged: list[tuple[float, int]] = []
    points = [level.start(each) for each in values]
    for k, point in enumerate(points):
        if len(judged) == count:
            break
        if np.isfinite(evidence := level.judgement(point)):
            judged.append((evidence, k))
    return [points[k] for _, k in sorted(judged)]


class Log:
    """Keep the points that a search visits, level by level, and report the fraction done."""

    def __init__(self, report: Callable[[float], None] | None) -> None:
        self._report = report or (lambda _: None)
        self._done, self._until, self._expected = 0.0, 0.0, 1
        self.visited: dict[int, list[tuple[Array, float]]] = {}

    def expect(self, visits: int, until: float) -> None:
        """Expect so many visits before a fraction of all is done."""
        self._done, self._until, self._expected = self._until, until, visits
        self._report(self._done)

    def at(self, level: int) -> Callable[[Array, float], None]:
        """Return what keeps the points of a level."""
        points = self.visited.setdefault(level, [])

        def visit(point: Array, evidence: float) -> None:
            points.append((point, evidence))
            self._done += (self._until - self._done) / max(self._expected, 1)
            self._expected -= self._expected > 2
            self._report(self._done)

        return visit

    def finish(self) -> None:
        """Report that all is done."""
        self._report(1.0)
