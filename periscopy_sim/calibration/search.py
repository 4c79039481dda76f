"""The search for the point that explains photographs best: cooled descents from prior draws.

The evidence has many valleys, because wrong scenes fit with other images. The search draws many
points from the prior, descends from those that explain most, and keeps the best after a few steps.
A descent begins where the evidence counts for little, so that only what the photographs show beyond
doubt leaves the prior, and goes on as it counts for more and more (a homotopy: Blake and Zisserman,
Visual Reconstruction, 1987). Fine descents follow from all ends, whose images are nonnegative and
have few edges; soon only that of the prior's centre and the best other go on. They find a valley,
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

HOTTEST = 128.0
"""Temperature, a photograph, from which fine descents and the last ones halve it."""

STEPS, TRIALS = 2, 4
"""Of a descent at each temperature, and of a step, each shorter than the one before."""

DRAWS, DESCENTS, KEPT = 64, 12, 3
"""Draws from the prior, the best of them, where coarse descents start, and how many descents go on
after the first temperature: of a sign's best 14, 3 end well, and are the best 3 after two steps."""

FOLLOWED = 3, 2, 2, 2, 2
"""How many fine descents go on after each temperature, from all coarse ends: while the best of
these was chosen before it, a shelf lost 18.7 dB and a chair 2.8; now they lose 0.2 and 0.9."""

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


def expected_stages(photographs: int, unknown: bool) -> tuple[int, int, int, int]:
    """Return how many draws, coarse, fine and last temperatures there are at most."""
    last = len(fine_cooling(photographs)) - len(FOLLOWED) + 1
    if not unknown:
        return 0, 0, len(FOLLOWED), last
    coarse = DESCENTS + KEPT * (len(COOLING) - 3) + len(COOLING)
    return DRAWS, coarse, KEPT + 1 + sum(FOLLOWED[:-1]), 2 * last


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
        """Return where fine descents start: at the prior's own coarse end, and at the others.

        A SceneError says that the prior's centre is no scene.
        """
        level, random = self.coarse, np.random.default_rng(self.seed)
        deviations = level.errors * random.standard_normal((DRAWS, len(level.errors)))
        drawn = level.center + np.pad(deviations, ((0, 0), (0, len(level.terms))))
        starts = nsmallest(DESCENTS, self._scenes(drawn), key=lambda each: each.evidence)
        (own,) = self._coarse_ends([level.candidate(level.center)], COOLING)
        curvature, apart = own.curvature(), [own.point]
        for end in self._coarse_ends(starts, COOLING[2:]):
            steps = np.array([end.point - point for point in apart])
            if np.min(np.einsum("ki,ij,kj->k", steps, curvature, steps)) > NEGLIGIBLE:
                apart.append(end.point)
        first, *others = map(self.fine.candidate, apart)
        return [first, *(each for each in others if each.explanations)]

    def _scenes(self, points: Array) -> Iterator[Candidate]:
        for candidate in map(self.coarse.candidate, points):
            if candidate.explanations:
                self.visit(0, candidate)
                yield candidate

    def best(self, starts: Sequence[Candidate]) -> tuple[ResolutionLevel, Look]:
        """Return the best look that descents from some fine candidates lead to, and its level."""
        cooling = fine_cooling(self.fine.photographs)
        looks = [self.fine.look(start, cooling[0]) for start in starts]
        for T, kept in zip(cooling, FOLLOWED, strict=False):
            looks = _led([self._cooled(self.fine, 2, look, T) for look in looks])[:kept]
        lead, *rivals = looks
        found = [lead, *(look for look in rivals if _gain(lead, look) > NEGLIGIBLE)]
        ends = {end: level for level, end in map(self._end, found)}
        best, *_ = _led([*ends])
        return ends[best], best

    def _end(self, found: Look) -> tuple[ResolutionLevel, Look]:
        """Return the end of a last descent, and its level."""
        level = self.fine.with_edges(found)
        look = level.look(level.candidate(found.point), found.temperature)
        for T in fine_cooling(level.photographs):
            if found.temperature >= T:
                look = self._cooled(level, 3, look, T)
        return level, look

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

    def _cooled(self, level: ResolutionLevel, stage: int, look: Look, T: float) -> Look:
        """Return the end of a descent, or its start if the prior forbids the end: it is over then.

        Photographs that move the parameters farther than chance errs in measured values show
        something that the scene lacks: they count for less.
        """
        if look.temperature > 2 * T:
            return look
        colder = self._descended(level, stage, look, T)
        far = is_significant(colder.penalty, len(look.point))
        return look if far and HOTTEST * level.photographs > T else colder


def _led(looks: list[Look]) -> list[Look]:
    """Return looks in order; the first keeps its place unless another explains significantly more.

    Where photographs cannot tell, the prior's centre leads.
    """
    lead, *rivals = looks
    rivals.sort(key=lambda look: -_gain(lead, look))
    if rivals and is_significant(_gain(lead, rivals[0]), len(lead.point)):
        return [*rivals, lead]
    return [lead, *rivals]


def _gain(look: Look, other: Look) -> float:
    """Return by how much another look's objective is less, at the hotter one's temperature."""
    hottest = max(look.temperature, other.temperature)
    return look.objective_at(hottest) - other.objective_at(hottest)
