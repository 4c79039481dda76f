"""The search for the point that explains photographs best: cooled descents from prior draws.

The evidence has many valleys, because wrong scenes fit with other images. The search draws many
points from the prior, descends from those that explain most, and keeps the best after a few steps.
A descent begins where the evidence counts for little, so that only what the photographs show beyond
doubt leaves the prior, and goes on as it counts for more and more (a homotopy: Blake and Zisserman,
Visual Reconstruction, 1987). Two fine descents follow, whose images are nonnegative and have few
edges: from the end of the prior's centre and from the best of the other ends. They find a valley,
but not its bottom, because the likeliest image of few edges goes with a biased scene. So each ends
in a last descent, which integrates over all images that have its edges.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, replace
from heapq import nsmallest

import numpy as np

from periscopy_sim.calibration.level import Candidate, Look, ResolutionLevel
from periscopy_sim.calibration.trust import is_significant
from periscopy_sim.scenario import Array

COOLING = 300.0, 100.0, 30.0, 10.0, 3.0
"""Temperatures of the coarse descent from the prior's centre, a photograph: from 30 on, the real
chair loses 1.7 dB. Draws start at the third, where two steps separate good draws from others."""

HOTTEST, COLDEST = 128.0, 8.0
"""Temperatures, a photograph, between which fine descents halve it; the last one goes on to 1."""

STEPS, TRIALS = 2, 4
"""Of a descent at each temperature, and of a step, each shorter than the one before."""

DRAWS, DESCENTS, KEPT = 64, 12, 3
"""Draws from the prior, the best of them, where coarse descents start, and how many descents go on
after the first temperature: of a sign's best 14, 3 end well, and are the best 3 after two steps."""

DAMPING = 1e-3
"""The first of a descent: fraction of the information that is added to it."""

NEGLIGIBLE = 0.5
"""Decrease of the objective, predicted or made, that ends a descent; closer ends count as one."""

LONGEST = 3.0
"""Of a step before it is doubled, in standard deviations of the prior."""


def fine_cooling(photographs: int) -> list[float]:
    """Return the temperatures of fine descents and the last one, of so many photographs."""
    count = int(np.ceil(np.log2(HOTTEST * photographs))) + 1
    return [max(HOTTEST * photographs / 2**k, 1.0) for k in range(count)]


def descend(level: ResolutionLevel, start: Look, temperature: float) -> Look:
    """Return the look after at most `STEPS` steps of Levenberg and Marquardt's method."""
    look, damping = replace(start, temperature=temperature), DAMPING
    for _ in range(STEPS):
        if look.predicted_gain < NEGLIGIBLE:
            break
        for _ in range(TRIALS):
            step = _step(level, look, damping)
            candidate = level.candidate(look.point + step)
            if candidate.objective_at(temperature) < look.objective:
                break
            damping = max(damping, DAMPING) * 10
        else:
            break
        # Valleys are rough: the information nearby exceeds that over the valley. A parabola that
        # falls by more than two thirds of what its slope promises is lower still at twice the step.
        while look.objective - candidate.objective_at(temperature) > -4 / 3 * look.downhill @ step:
            farther = level.candidate(look.point + 2 * step)
            if farther.objective_at(temperature) >= candidate.objective_at(temperature):
                break
            step, candidate = 2 * step, farther
        gain, damping = look.objective - candidate.objective_at(temperature), damping / 5
        look = level.look(candidate, temperature)
        if gain < NEGLIGIBLE:
            break
    return look


def _step(level: ResolutionLevel, look: Look, damping: float) -> Array:
    """Return Newton's step; parameters that alone would cross the border of the physical stay."""
    free = np.ones(len(look.point), bool)
    for _ in range(2):
        step = np.zeros(len(free))
        curvature = look.curvature(damping)[np.ix_(free, free)]
        step[free] = -np.linalg.solve(curvature, look.downhill[free])
        step /= max(1.0, float(np.max(np.abs(step) * np.sqrt(look.precision))) / LONGEST)
        if level.scene.is_physical(level.values(look.point + step)):
            break
        for k in range(len(level.centers)):
            alone = look.point.copy()
            alone[k] += step[k]
            free[k] = level.scene.is_physical(level.values(alone))
    return step


@dataclass(frozen=True, eq=False)
class Search:
    """Levels of the same photographs: `coarse` to begin on, then `fine`, then its `with_edges`."""

    coarse: ResolutionLevel
    fine: ResolutionLevel
    seed: int
    visit: Callable[[int, Candidate], None]  # a draw, 0; an end: coarse 1, fine 2, last 3

    def starts(self) -> list[Candidate]:
        """Return where fine descents start: at the prior's own coarse end, and at the best other.

        A SceneError says that the prior's centre is no scene.
        """
        level, random = self.coarse, np.random.default_rng(self.seed)
        deviations = level.errors * random.standard_normal((DRAWS, len(level.errors)))
        drawn = level.center + np.pad(deviations, ((0, 0), (0, len(level.terms))))
        starts = nsmallest(DESCENTS, self._scenes(drawn), key=lambda each: each.evidence)
        (own,) = self._coarse_ends([level.candidate(level.center)], COOLING)
        steps = [end.point - own.point for end in self._coarse_ends(starts, COOLING[2:])]
        apart = [own.point + s for s in steps if s @ own.curvature() @ s > NEGLIGIBLE]
        first, *others = map(self.fine.candidate, [own.point, *apart])
        return [first, *nsmallest(1, others, key=lambda each: each.objective_at(1.0))]

    def _scenes(self, points: Array) -> Iterator[Candidate]:
        for candidate in map(self.coarse.candidate, points):
            if candidate.explanations:
                self.visit(0, candidate)
                yield candidate

    def best(self, starts: Sequence[Candidate]) -> tuple[ResolutionLevel, Look]:
        """Return the best look that descents from some fine candidates lead to, and its level."""
        (level, best), *others = map(self._end, starts)
        for other_level, other in others:
            # Where photographs cannot tell, the end of the prior's centre is kept.
            hottest = max(best.temperature, other.temperature)
            gain = best.objective_at(hottest) - other.objective_at(hottest)
            if is_significant(gain, len(best.point)):
                level, best = other_level, other
        return level, best

    def _end(self, start: Candidate) -> tuple[ResolutionLevel, Look]:
        """Return the end of a fine descent and a last one, and its level."""
        cooling = fine_cooling(self.fine.photographs)
        hot = [each for each in cooling if each >= COLDEST * self.fine.photographs]
        found = self.fine.look(start, cooling[0])
        found = self._cooled(self.fine, 2, found, hot)
        level = self.fine.with_edges(found)
        look = level.look(level.candidate(found.point), found.temperature)
        return level, self._cooled(level, 3, look, [T for T in cooling if look.temperature >= T])

    def _descended(self, level: ResolutionLevel, stage: int, look: Look, T: float) -> Look:
        look = descend(level, look, T)
        self.visit(stage, look)
        return look

    def _coarse_ends(self, starts: list[Candidate], cooling: Sequence[float]) -> list[Look]:
        looks = [self.coarse.look(each) for each in starts]
        for T in self.coarse.photographs * np.array(cooling):
            looks = [self._descended(self.coarse, 1, look, T) for look in looks]
            looks = nsmallest(KEPT, looks, key=lambda look: look.objective)
        return looks

    def _cooled(
        self, level: ResolutionLevel, stage: int, look: Look, cooling: Sequence[float]
    ) -> Look:
        """Return the coldest look of a descent that the prior allows.

        Photographs that move the parameters farther than chance errs in measured values show
        something that the scene lacks: they count for less.
        """
        for T in cooling:
            colder = self._descended(level, stage, look, T)
            if HOTTEST * level.photographs > T and is_significant(colder.penalty, len(look.point)):
                break
            look = colder
        return look
