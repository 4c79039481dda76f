"""The search for the point that explains photographs best: cooled descents from prior draws.

A descent begins where the evidence counts for little, so that only what the photographs show beyond
doubt leaves the prior, and goes on as it counts for more and more (a homotopy: Blake and Zisserman,
Visual Reconstruction, 1987). What the photographs leave open stays where the prior is centred. So
descents with centres that are drawn from the prior end in different places that explain the
photographs nearly as well (randomize, then optimize: Bardsley et al., SIAM J. Sci. Comput. 36,
2014). The noise-aware method's objective at these ends chooses among them.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace

import numpy as np

from periscopy_sim.calibration.level import Look, ResolutionLevel
from periscopy_sim.errors import SceneError
from periscopy_sim.reconstruction.noise_aware.noise_aware import NoiseAware
from periscopy_sim.scenario import Array

COOLING = 300.0, 100.0, 30.0, 10.0, 3.0
"""Temperatures of a coarse descent: colder starts end in the nearest minimum."""

FINE_COOLING = 10.0, 3.0, 1.0, 1.0, 1.0
"""Temperatures of a fine descent."""

STEPS = 2
"""Of a descent at each temperature."""

DRAWS = 5
"""Centres drawn from the prior, beside its own."""

DAMPING = 1e-3
"""The first of a descent: fraction of the information that is added to it."""

NEGLIGIBLE = 0.5
"""Decrease of the objective, predicted or made, that is not worth a step."""

TRIALS = 4
"""Steps tried, each shorter, before a point is called the best."""

LONGEST = 3.0
"""Of a step, in standard deviations of the prior."""

Visit = Callable[[Look], None]


def descend(level: ResolutionLevel, start: Look, temperature: float, visit: Visit) -> Look:
    """Return the look after at most `STEPS` steps of Levenberg and Marquardt's method."""
    look, damping = replace(start, temperature=temperature), DAMPING
    for _ in range(STEPS):
        if look.predicted_gain < NEGLIGIBLE:
            break
        for _ in range(TRIALS):
            step = _step(level, look, damping)
            objective = level.objective(look.point + step, temperature)
            if objective < look.objective:
                break
            damping = max(damping, DAMPING) * 10
        else:
            break
        # Valleys are rough: the information nearby exceeds that over the valley.
        while (farther := level.objective(look.point + 2 * step, temperature)) < objective:
            step, objective = 2 * step, farther
        gain, damping = look.objective - objective, damping / 5
        look = level.look(look.point + step, temperature)
        visit(look)
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
    """Levels of the same photographs: `coarse` and `fine` to descend on, `whole` to judge by."""

    coarse: ResolutionLevel
    fine: ResolutionLevel
    whole: ResolutionLevel
    seed: int
    visit: Callable[[int, Look], None]  # with 0 at the coarse level, 1 at the fine one

    def best(self) -> Look:
        """Return the fine look that the noise-aware image favours.

        A SceneError says that the prior's centre is no scene.
        """
        random = np.random.default_rng(self.seed)
        ends = [self._coarse_end(self.coarse)]
        for _ in range(DRAWS):
            deviation = random.standard_normal(len(self.coarse.centers))
            centers = self.coarse.centers + self.coarse.errors * deviation
            try:
                ends.append(self._coarse_end(replace(self.coarse, centers=centers)))
            except SceneError:
                continue
        judged = [self.judge(end) for end in ends]
        # The prior's own end is followed whatever the judge says: it is the most likely before.
        starts = {0, int(np.argmin(judged))}
        looks = [self.followed(ends[k]) for k in sorted(starts)]
        return min(looks, key=lambda look: self.judge(look.point)) if looks[1:] else looks[0]

    def _coarse_end(self, level: ResolutionLevel) -> Array:
        return self._cooled(0, level, level.center, COOLING).point

    def followed(self, point: Array) -> Look:
        """Return the look where the fine level leads from a point, at its own temperature."""
        look = self._cooled(1, self.fine, point, FINE_COOLING)
        temperature = self.fine.temperature(look)
        return descend(self.fine, look, temperature, lambda look: self.visit(1, look))

    def _cooled(
        self, number: int, level: ResolutionLevel, point: Array, cooling: Sequence[float]
    ) -> Look:
        def visit(look: Look) -> None:
            self.visit(number, look)

        look = level.look(point)
        visit(look)
        for temperature in cooling:
            look = descend(level, look, temperature, visit)
        return look

    def judge(self, point: Array) -> float:
        """Return the objective of the noise-aware method at a point, the prior's penalty included.

            J = Σ_c F log ‖y⊥_c − A⊥ f̂_c‖² + λ Σ ‖∇f̂‖ + penalty,

        summed over the photographs, whose images all count as unknown. The noise is eliminated; the
        smaller J, the better.
        """
        level = self.whole
        A, Q = level.bright_transport(point), level.background
        hidden = level.scene.scenario.hidden_shape
        method = NoiseAware(A, Q, hidden_shape=hidden, profiles=False, corrections=())
        channels = np.hstack([group.light for group in level.groups]).T
        objective = level.penalty(point)
        for light in channels.reshape(-1, 3, len(A)):
            (evidence,) = method.evidence(light.T[None])
            solution, _ = method.recover(evidence)
            f = solution.image
            rest = light - (A @ f.reshape(-1, 3)).T
            misfit = np.sum(method.fit.project_out(rest) ** 2, axis=1)
            steps = [np.diff(f, axis=axis, append=np.take(f, [-1], axis)) for axis in (0, 1)]
            variation = np.sqrt(np.sum(np.square(steps), axis=(0, 3))).sum()
            freedom = len(A) - Q.shape[1]
            objective += float(freedom * np.log(misfit).sum() + solution.weight * variation)
        return objective
