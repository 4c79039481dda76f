"""Levenberg and Marquardt's descent to the parameters that explain a photograph best.

The slope of the evidence is taken from differences of transport matrices either side, its curvature
from how the photograph moves with a parameter beyond what hidden image and light could follow
(Gauss and Newton's approximation; Kaufman, BIT 15, 1975).
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from periscopy_sim.calibration.evidence import Explanation
from periscopy_sim.calibration.resolution_level import Level, Values
from periscopy_sim.errors import SceneError
from periscopy_sim.scenario import Array

Visit = Callable[[Values, float], None]

DAMPING = 1e-3
"""The first: part of the curvature that is added to it."""

NOTHING = 0.5
"""Gain in evidence, expected or made, that is not worth a step: of at most 0.7 standard errors."""

DOUBLINGS = 3
"""Of a step, at most."""

UNSEEN = 1e-4
"""Part of the information below which a direction of the parameters counts as unknown."""

TRIALS = 5
"""Steps tried, each shorter, before a point is called the best."""


@dataclass(frozen=True, eq=False)
class Descent:
    """Where a descent ended.

    Attributes
    ----------
    values
        (P,) the best parameters.
    explanation
        Of the photograph by them.
    unphysical
        Why it went no further, if the border of the physical stopped it.
    """

    values: Values
    explanation: Explanation
    unphysical: SceneError | None


@dataclass(frozen=True, eq=False)
class Curvature:
    """What the photograph tells about the parameters, about one point.

    Attributes
    ----------
    slope
        (P,) derivatives of half the evidence.
    information
        (P, P) Fisher information.
    noisy
        (P,) its diagonal with the rendering's noise in it: more than it.
    scores
        (blocks, P) what each block of pixels adds to the slope of the misfit.
    scatter
        (P,) half of how the slopes by two sets of rays differ: standard errors of their mean, the
        signs those of one draw.
    """

    slope: Array
    information: Array
    noisy: Array
    scores: Array
    scatter: Array

    def damped(self, damping: float) -> Array:
        """Add a part of the diagonal to the information, and what noise made negative in it."""
        scale = 1 / np.sqrt(self.noisy)
        values, vectors = np.linalg.eigh(self.information * np.outer(scale, scale))
        damped = (vectors * (np.maximum(values, 0) + damping)) @ vectors.T
        return np.asarray(damped / np.outer(scale, scale))

    def invertible(self) -> Array:
        """Give the information, (P, P), raised to a little where there is none: to be inverted."""
        return self.damped(UNSEEN)

    def first(self, count: int) -> Curvature:
        """Leave out all parameters but the first."""
        return Curvature(
            slope=self.slope[:count],
            information=self.information[:count, :count],
            noisy=self.noisy[:count],
            scores=self.scores[:, :count],
            scatter=self.scatter[:count],
        )

    def step(self, damping: float, longest: Values) -> Values:
        """Step to where the slope vanishes (Newton's), no parameter further than its longest."""
        step = -np.linalg.solve(self.damped(damping), self.slope)
        return np.asarray(step * min(1.0, np.min(longest / np.maximum(np.abs(step), 1e-300))))

    @property
    def promised(self) -> float:
        """Gain in evidence that the slope promises to a whole step, undamped."""
        return float(self.slope @ np.linalg.solve(self.invertible(), self.slope))

    def covariance(self) -> Array:
        """Give the parameters' covariance, (P, P).

        What the model leaves unexplained is no white noise, so its spread is taken from the
        photograph: blocks of pixels are independent, not pixels (the sandwich estimate: White,
        Econometrica 50, 1982). It is never taken below that of white noise. What the rays add is
        from the slope's scatter.
        """
        scale = 1 / np.sqrt(self.noisy)
        normalized = self.invertible() * np.outer(scale, scale)
        inverse = np.linalg.inv(normalized)
        scores = self.scores * scale
        spread = scores.T @ scores
        white, robust = np.diag(inverse), np.diag(inverse @ spread @ inverse)
        growth = np.sqrt(np.maximum(robust / white, 1))
        by_rays = inverse @ (scale * self.scatter)
        covariance: Array = inverse * np.outer(growth, growth) + np.outer(by_rays, by_rays)
        return covariance * np.outer(scale, scale)


def curvature(level: Level, values: Values, explanation: Explanation, steps: Values) -> Curvature:
    """Differentiate about some values.

    Each difference is rendered twice, with independent rays. Hidden image and light could follow
    nearly all of how the photograph moves; in the little that is left the noise of one rendering,
    multiplied by itself, would pass for information.

    Parameters
    ----------
    level
        Where to look.
    values
        (P,) parameters.
    explanation
        Of the level at those values.
    steps
        (P,) differences to either side.

    Raises
    ------
    SceneError
        If neither side of a parameter is physical.
    """
    slopes, steered, noisy = [], [], []
    moved: tuple[list[Array], list[Array]] = ([], [])
    for k, step in enumerate(steps):
        offset = np.zeros(len(values))
        offset[k] = step
        changes = [_difference(level, values, offset, level.seed + s) / step for s in (0, 1)]
        slopes.append([explanation.slope(change) / 2 for change in changes])
        beyond = [explanation.steer(change) for change in changes]
        for own, change in zip(moved, changes, strict=True):
            own.append(explanation.moved(change))
        steered.append(beyond)
        noisy.append(np.mean([np.vdot(s, m[-1]) for s, m in zip(beyond, moved, strict=True)]))
    first, second = (np.array([beyond[s] for beyond in steered]) for s in (0, 1))
    information = np.einsum("imc,jmc->ij", first, np.array(moved[1]))
    residuals = explanation.residuals / explanation.noise
    by_seed = np.array(slopes)
    return Curvature(
        slope=by_seed.mean(axis=1),
        information=(information + information.T) / 2,
        noisy=np.array(noisy),
        scores=_by_block(np.einsum("imc,mc->mi", (first + second) / 2, residuals), level),
        scatter=(by_seed[:, 0] - by_seed[:, 1]) / 2,
    )


def _difference(level: Level, values: Values, offset: Values, seed: int) -> Array:
    """Give half the change of A from one side to the other; all of it where one is not physical."""
    sides = []
    for sign in (1, -1):
        try:
            sides.append((sign, level.matrix(values + sign * offset, seed)))
        except SceneError as error:
            unphysical = error
    if len(sides) == 2:
        return np.asarray((sides[0][1] - sides[1][1]) / 2)
    if not sides:
        raise unphysical
    sign, A = sides[0]
    return np.asarray(sign * (A - level.matrix(values, seed)))


BLOCKS = 10
"""Along each side of the photograph."""


def _by_block(weighed: Array, level: Level) -> Array:
    """Add up pixels' scores over square blocks."""
    rows, columns = np.nonzero(level.used)
    height, width = level.photograph_shape
    block = (rows * BLOCKS // height) * BLOCKS + columns * BLOCKS // width
    sums = np.zeros((BLOCKS**2, weighed.shape[1]))
    np.add.at(sums, block, weighed)
    return sums


def descend(
    level: Level,
    start: Values,
    steps: Values,
    longest: Values,
    iterations: int,
    visit: Visit,
) -> Descent:
    """Walk downhill until nothing is gained.

    Parameters
    ----------
    level
        Where to look.
    start
        (P,) parameters.
    steps
        (P,) differences by which slopes are taken.
    longest
        (P,) at most so far in one step, before it is doubled.
    iterations
        At most.
    visit
        Told each point and its evidence.

    Returns
    -------
    Descent
        Where it ended.

    Raises
    ------
    SceneError
        If the start is not physical.
    """
    values, here = start, level.explain(start)
    visit(values, here.evidence)
    damping, gain, unphysical = DAMPING, np.inf, None
    for _ in range(iterations):
        if gain < NOTHING:
            break
        about = curvature(level, values, here, steps)
        gain, unphysical = 0.0, None
        if about.promised < NOTHING:
            break
        for trial in range(TRIALS):
            step = about.step(damping, longest)
            try:
                tried = level.explain(values + step)
            except SceneError as error:
                unphysical = error if trial == 0 else unphysical
            else:
                if tried.evidence < here.evidence:
                    step, tried = _further(level, values, step, tried)
                    gain = here.evidence - tried.evidence
                    values, here = values + step, tried
                    visit(values, here.evidence)
                    damping /= 5
                    break
            damping = max(damping, DAMPING) * 10
    return Descent(values, here, unphysical if gain < NOTHING else None)


def _further(
    level: Level, values: Values, step: Values, reached: Explanation
) -> tuple[Values, Explanation]:
    """Double a step while that gains: one rendering, where a new direction takes 4 P."""
    for _ in range(DOUBLINGS):
        try:
            tried = level.explain(values + 2 * step)
        except SceneError:
            break
        if tried.evidence >= reached.evidence:
            break
        step, reached = 2 * step, tried
    return step, reached


def settle(
    level: Level, end: Descent, about: Curvature, longest: Values
) -> tuple[Values, Explanation]:
    """Take the step that a descent's end still asks for, if other rays agree.

    Between places so near, the evidence by the descent's own rays tells more of the rays than of
    the places; its slope, of wide differences and of two sets of rays, does not.

    Parameters
    ----------
    level
        Where to look.
    end
        Of the descent.
    about
        The curvature there.
    longest
        (P,) at most so far.

    Returns
    -------
    values, explanation
        There; those of the descent's end where rays that chose neither place find that one better,
        or the step is not physical.
    """
    there, other = end.values + about.step(UNSEEN, longest), level.seed + 2
    try:
        reached = level.explain(there)
        better = level.explain(there, other).evidence < level.explain(end.values, other).evidence
    except SceneError:
        better = False
    return (there, reached) if better else (end.values, end.explanation)
