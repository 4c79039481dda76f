"""The search for the point that explains photographs best: cooled descents from prior draws.

The evidence has many valleys, because wrong scenes fit with other images. So a scan draws many
points from a prior that is wider than the ruler's, and compares them by smooth images, which is
cheap. From the best of these, and from the measured values, descents by smooth images lead to the
valleys' bottoms. A descent begins where the evidence counts for little, so that only what the
photographs show beyond doubt leaves the prior, and goes on as it counts for more and more (a
homotopy: Blake and Zisserman, Visual Reconstruction, 1987). Fine descents follow from the best
ends. Their images are nonnegative and have few edges. The better one goes on until it gains little.
An image and a scene that move together send the wall nearly the same light, so the search hops to
places aside as long as the photographs show that the image belongs there; those that remain likely
widen the errors. The end is not at the bottom, because the likeliest image of few edges goes with a
biased scene. A last descent integrates over all images that have its edges. This descent counts if
it cools to 1.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator, Sequence
from dataclasses import dataclass, field, replace
from functools import partial
from heapq import nsmallest
from itertools import chain
from operator import itemgetter
from typing import ClassVar

import numpy as np
from scipy import special
from scipy.special import expit
from scipy.stats import qmc

from periscopy_sim.calibration import prior, trust
from periscopy_sim.calibration.resolution_level import Candidate, Look, ResolutionLevel
from periscopy_sim.numerics import Array

COOLING = 300.0, 100.0, 30.0, 10.0, 3.0
"""Temperatures of the coarse descents, a photograph: from 30 on, the real chair loses 1.7 dB."""

HOTTEST = 16.0
"""Temperature, a photograph, from which fine descents and the last ones halve it. From 128 a real
chair takes twice as long and is no better."""

STEPS, TRIALS = 2, 4
"""Steps of a descent at each temperature, and trials of a step, each shorter than the last."""

DRAWS, WIDTH = 256, 1.5
"""Draws of the scan, and their standard deviations over the prior's, up to `FARTHEST`."""

APART = 0.4
"""Standard deviations of the prior by which draws differ that are proposed."""

PROPOSED, JOINING = 12, 2
"""Most draws that descend, and the number of the temperature at which they join the descent from
the centre; half of these go on after each temperature. In ten photographs by plain Mitsuba, and a
real one of a ball, the right valley was then the first or the second of the draws' ends."""

STARTS = 3
"""Most places from which fine descents start, the end of the centre's descent one of them: from one
of 16 rulers of a real ball two led to another valley."""

DAMPING, SHORTER = 1e-3, 4.0
"""Fraction of the information that is added to it, and factor of the curvature after a step too far
whose end is no scene, or shows no more curvature."""

NEGLIGIBLE = 0.5
"""Decrease of the objective, predicted or made, that ends a descent. Two ends that are both as near
to one bottom count as one."""

ROUNDS, LEAST_GAIN = 8, 3.0
"""Most descents at the last temperature, coarse or fine, and the decrease of the objective below
which one is the last: a chair of `wrong_scenes` gains 6 dB in eight, and coarse ones find a real
ball from one of 16 rulers that is not found without."""

ASIDES, SPREAD = 2, 20.0
"""Most rivals; and the difference of the edged images' evidence, −2 log, at which one place of the
image is e times as likely as another: a spread of 18.6 fits 160 pairs of places best, in 14
photographs by plain Mitsuba."""

SHIFTS, FAINT = (0.5, 1.0, 2.0, 4.0, 8.0), 5.0
"""Patches by which images are tried aside; and −log of the odds below which none is likely."""

UNLIKELY = 0.05
"""Probability, against the best place, above which a place aside is a rival; chosen."""

SHARES = 0.03, 0.07, 0.79, 0.06
"""Fractions of the time that draws, coarse, fine and last descents take (a real chair), places
aside being fine ones, for the progress alone; the rest is the standard errors'."""


def fine_cooling(photographs: int) -> list[float]:
    """Return the temperatures of fine descents and the last one, of so many photographs."""
    count = int(np.ceil(np.log2(HOTTEST * photographs))) + 1
    return [max(HOTTEST * photographs / 2**k, 1.0) for k in range(count)]


def descend(level: ResolutionLevel, start: Look, temperature: float) -> Look:
    """Return the look after at most `STEPS` Newton steps; failed ones correct the curvature."""
    look = replace(start, temperature=temperature)
    for _ in range(STEPS):
        if look.predicted_gain < NEGLIGIBLE:
            break
        curvature = look.curvature(DAMPING)
        for _ in range(TRIALS):
            step = _step(level, look, curvature)
            candidate = level.candidate(look.point + step)
            if candidate.objective_at(temperature) < look.objective:
                break
            curvature = _steeper(level, look, curvature, candidate)
        else:
            break
        # Valleys are rough: the information nearby exceeds that over the valley. A parabola that
        # falls by more than two thirds of what its slope promises is lower still at twice the step.
        while look.objective - candidate.objective_at(temperature) > -4 / 3 * look.downhill @ step:
            farther = level.candidate(look.point + 2 * step)
            if farther.objective_at(temperature) >= candidate.objective_at(temperature):
                break
            step, candidate = 2 * step, farther
        gain = look.objective - candidate.objective_at(temperature)
        look = level.look(candidate, temperature)
        if gain < NEGLIGIBLE:
            break
    return look


def _steeper(level: ResolutionLevel, look: Look, curvature: Array, beyond: Candidate) -> Array:
    """Return a curvature that a step which led too far has corrected.

    Where two faces of a scene lie in one plane, light has a corner: past it the slope is another.
    The update of symmetric rank one gives the curvature along the step that the slopes at its ends
    show (Conn, Gould, Toint, Math. Program. 50, 1991), so that the other parameters still move.
    """
    step = beyond.point - look.point
    if beyond.explanations:
        change = level.look(beyond, look.temperature).downhill - look.downhill - curvature @ step
        if change @ step > 0:
            return np.asarray(curvature + np.outer(change, change) / (change @ step))
    return SHORTER * curvature


def _step(level: ResolutionLevel, look: Look, curvature: Array) -> Array:
    """Return Newton's step, no longer than `FARTHEST`.

    Parameters that alone would cross the border of the physical stay.
    """
    free = np.ones(len(look.point), bool)
    for _ in range(2):
        step = np.zeros(len(free))
        step[free] = -np.linalg.solve(curvature[np.ix_(free, free)], look.downhill[free])
        step /= max(1.0, float(np.max(np.abs(step) * np.sqrt(look.precision))) / prior.FARTHEST)
        if level.scene.is_physical(level.values(look.point + step)):
            break
        for k in range(len(level.centers)):
            alone = look.point.copy()
            alone[k] += step[k]
            free[k] = level.scene.is_physical(level.values(alone))
    return step


@dataclass(frozen=True, eq=False)
class Place:
    """A scene whose image lies so many patches aside, and how unlikely it is."""

    scene: Candidate
    surprise: float  # −log of the probability, but for a constant
    patches: float

    def against(self, other: Place) -> float:
        """Return the logarithm of another place's odds."""
        return self.surprise - other.surprise


@dataclass(frozen=True, eq=False)
class Search:
    """Levels of the same photographs.

    The search begins on `coarse`, continues on `fine`, and ends on its `with_edges`.
    """

    coarse: ResolutionLevel
    fine: ResolutionLevel
    joint: ResolutionLevel  # on which unknown images have a place
    seed: int
    progress: Callable[[float], None] = lambda _: None  # called with the fraction done
    # The ends beside the best, of other places of the image, each so many times as likely.
    rivals: list[tuple[Look, float]] = field(default_factory=list, init=False)
    # Second moments about the best, (P, P), of scenes aside, one for each direction.
    spread: list[Array] = field(default_factory=list, init=False)
    drawn: ClassVar[int] = DRAWS  # how many scenes are compared before descents
    _rows: tuple[list[Array], ...] = field(default_factory=lambda: ([], [], [], []), init=False)

    @property
    def path(self) -> tuple[Array, ...]:
        """The rows of `Calibration.path`."""
        return tuple(np.reshape(rows, (-1, len(self.fine.centers) + 1)) for rows in self._rows)

    def visit(self, stage: int, candidate: Candidate) -> None:
        """Add a draw, 0, or a temperature's end: 1 coarse, 2 fine, 3 last."""
        values = self.fine.values(candidate.point)
        self._rows[stage].append(np.append(values, candidate.cost))
        coarse = len(COOLING) + 2 * PROPOSED + ROUNDS
        fine = STARTS + 1 + 2 * len(fine_cooling(self.fine.photographs)) + ROUNDS * (1 + ASIDES)
        most = self.drawn, coarse, fine, 1
        ended = min(len(self._rows[stage]) / most[stage], 1.0)
        self.progress(sum(SHARES[:stage]) + SHARES[stage] * ended)

    def starts(self) -> list[Candidate]:
        """Return where fine descents start: at the prior's own coarse end, and where a scan leads.

        A SceneError says that the prior's centre is no scene.
        """
        level, drawn = self.coarse, self.scanned()
        own, others = level.look(level.candidate(level.center)), list[Look]()
        for k, T in enumerate(COOLING):
            if k == JOINING:
                others = [level.look(each) for each in drawn]
            own, *others = [
                self.descended(level, 1, look, T * level.photographs) for look in (own, *others)
            ]
            others = nsmallest(-(-len(others) // 2), others, key=lambda look: look.objective)
        distinct = _distinct([self.settled(level, 1, look) for look in (own, *others)])[:STARTS]
        first, *rest = [self.fine.candidate(look.point) for look in distinct]
        return [first, *filter(_is_scene, rest)]

    def scanned(self) -> list[Candidate]:
        """Return draws of the prior that differ, those that explain most with smooth images."""
        level, errors, costs = self.coarse, self.coarse.scene.errors, list[tuple[float, Array]]()
        sobol = qmc.Sobol(len(errors), seed=self.seed).random(DRAWS)
        steps = np.clip(WIDTH * special.ndtri(sobol), -prior.FARTHEST, prior.FARTHEST)
        points = np.pad(level.centers + steps * errors, ((0, 0), (0, len(level.terms))))
        for point in points:  # a scene is large: it is made again if it is kept
            scene = level.candidate(point)
            if _is_scene(scene):
                self.visit(0, scene)
                costs.append((scene.cost, point))
        return self.distinct(costs, PROPOSED)

    def distinct(self, costs: Iterable[tuple[float, Array]], most: int) -> list[Candidate]:
        """Return coarse scenes of points that differ, those of the least of their costs."""
        level, kept = self.coarse, list[Array]()
        for _, point in sorted(costs, key=itemgetter(0)):
            steps = [level.values(point - other) / level.scene.errors for other in kept]
            if len(kept) < most and all(np.linalg.norm(step) > APART for step in steps):
                kept.append(point)
        return [level.candidate(point) for point in kept]

    def best(self, starts: Sequence[Candidate]) -> tuple[ResolutionLevel, Look]:
        """Return the best look that descents from some fine candidates lead to, and its level."""
        level, cooling = self.fine, fine_cooling(self.fine.photographs)
        looks = [level.look(start, cooling[0]) for start in starts]
        for T in cooling:
            looks = self._ranked(level, [self._cooled(level, 2, look, T) for look in looks])
            if level is self.fine:
                level, looks = _with_misfit(level, looks)
        best = self._hopped(level, self.settled(level, 2, looks[0]))
        self.rivals[:] = [(self._end(level, rival)[1], odds) for rival, odds in self.rivals]
        return self._end(level, best)

    def _ranked(self, level: ResolutionLevel, looks: list[Look]) -> list[Look]:
        """Return looks, the best first; but the first stays unless another is significantly better.

        They are compared at the coldest of their temperatures, since a wrong scene may stay hot,
        and with all images integrated over that have the edges of a look's: in dim light the
        likeliest image of few edges is black anywhere.
        """
        if len(looks) == 1:
            return looks
        T = min(look.temperature for look in looks)
        edged = [edged_candidate(level, look).objective_at(T) for look in looks]
        order = sorted(range(len(looks)), key=edged.__getitem__)
        if not trust.is_significant(edged[0] - edged[order[0]], len(looks[0].point)):
            order.sort(key=lambda k: k > 0)
        return [looks[k] for k in order]

    def settled(self, level: ResolutionLevel, stage: int, look: Look) -> Look:
        """Return where a descent ends that goes on until it gains little.

        Edges stay in an image until the scene has moved far enough, so the descent takes ten and
        more steps of equal length.
        """
        for _ in range(ROUNDS):
            before, on = look, self.descended if stage == 1 else self._cooled
            look = on(level, stage, look, look.temperature)
            if before.objective - look.objective < LEAST_GAIN:
                break
        return look

    def _hopped(self, level: ResolutionLevel, look: Look) -> Look:
        """Return the likeliest look that images aside lead to.

        Others that may be right widen the errors; of these, those in other valleys become `rivals`.
        """
        T, here = look.temperature, self._place(level, look, look.temperature)
        while True:
            directions = [*self._follows(here.scene.point, T)]
            lines = self._lines(level, here, directions, T)
            asides = sorted(chain(*lines), key=lambda each: each.surprise)
            if not asides or here.against(asides[0]) < 1:
                break
            here = self._ended(level, asides[0], T)
        if asides and here.against(asides[0]) > 0:
            # What lies aside of it was seen from here: another look might lead on by little odds.
            best, former = asides[0], replace(here, patches=asides[0].patches)
            lines = [[former, *(each for each in line if each is not best)] for line in lines]
            asides = sorted([former, *asides[1:]], key=lambda each: each.surprise)
            here = self._ended(level, best, T)
        self.spread[:] = map(partial(self._moments, here), lines, directions)
        for aside in asides[:ASIDES]:
            if expit(here.against(aside)) > UNLIKELY and self._has_barrier(level, here, aside, T):
                rival = level.look(aside.scene, T)
                self.rivals.append((rival, float(np.exp(here.against(aside)))))
        return level.look(here.scene, T)

    def _has_barrier(self, level: ResolutionLevel, one: Place, other: Place, T: float) -> bool:
        """Return whether the scene between two places is less likely than either."""
        middle = level.candidate((one.scene.point + other.scene.point) / 2)
        between = self._place(level, middle, T)
        return max(one.against(between), other.against(between)) < -1

    def _ended(self, level: ResolutionLevel, aside: Place, T: float) -> Place:
        """Return a place or, if that is likelier, where a descent from it ends."""
        end = self.settled(level, 2, level.look(aside.scene, T))
        return min(aside, self._place(level, end, T), key=lambda each: each.surprise)

    def _moments(self, here: Place, asides: Sequence[Place], direction: Array) -> Array:
        """Return second moments about a place, (P, P), of it and those aside on one line.

        Each stands for the patches between it and the next one: the evidence is rough within a
        patch, so the image's place is uniformly distributed there.
        """
        step = self.fine.values(direction)
        weights, moments = [SHIFTS[0]], SHIFTS[0] ** 3 / 12 * np.outer(step, step)
        for aside in asides:
            weights.append(aside.patches * float(np.exp(here.against(aside))))
            step = self.fine.values(aside.scene.point - here.scene.point)
            moments += weights[-1] * np.outer(step, step)
        return np.asarray(moments / sum(weights))

    def _lines(
        self, level: ResolutionLevel, here: Place, directions: Sequence[Array], T: float
    ) -> list[list[Place]]:
        """Return likely places whose images lie aside, or grow, along some directions, (P + K,)."""

        def moved(direction: Array, patches: float) -> Candidate:
            return level.candidate(here.scene.point + patches * direction)

        return [self._asides(level, here, partial(moved, each), T) for each in directions]

    def _asides(
        self, level: ResolutionLevel, here: Place, moved: Callable[[float], Candidate], T: float
    ) -> list[Place]:
        """Return likely places on one line, whose scenes are `moved` by so many patches.

        A side ends where two in succession are unlikely: half a patch aside of a right place most
        are.
        """
        asides = []
        for side in 1, -1:
            is_likely = True
            for shift in SHIFTS:
                aside = self._place(level, moved(side * shift), T, shift)
                before, is_likely = is_likely, here.against(aside) > -FAINT
                if is_likely:
                    asides.append(aside)
                elif not before:
                    break
        return asides

    def _place(
        self, level: ResolutionLevel, scene: Candidate, T: float, patches: float = 0.0
    ) -> Place:
        """Return a scene as a place of the image, as likely as all images with its edges make it.

        The objective of images of few edges is rough, and depends on what the border cuts off.
        """
        if not _is_scene(scene):
            return Place(scene, np.inf, patches)
        return Place(
            scene, edged_candidate(level, scene).cost / T / SPREAD + scene.penalty / 2, patches
        )

    def _follows(self, point: Array, T: float) -> Iterator[Array]:
        """Yield how a point follows an image, for each number of `Surface.placed`, a patch each.

        It is the regression on the image's place, smooth images and their places integrated.
        """
        joint, first, last = self.joint, len(self.fine.centers), len(self.joint.scene.names)
        places = range(first, first + len(joint.centers) - last)
        if not places:  # a picture is known
            return
        stays = np.delete(np.arange(len(joint.center)), np.s_[first:last])  # not uncertain numbers
        whole = joint.center.copy()
        whole[stays] = np.insert(point, [first] * len(places), 0.0)
        joint = joint.with_misfit(joint.candidate(whole))
        curvature = joint.look(joint.candidate(whole), T).curvature()
        covariance = np.linalg.inv(curvature[np.ix_(stays, stays)])
        for place in places:
            yield np.delete(covariance[place] / covariance[place, place], places)

    def _end(self, level: ResolutionLevel, start: Look) -> tuple[ResolutionLevel, Look]:
        """Return the end of a last descent, and its level; or its start if it stays hot.

        Hot is above 1. What the scene then lacks biases it more than the likeliest image does:
        from five rulers of a real chair a last descent lost 0, 0, 0.6, 0.6 and 1.2 dB.
        """
        edged = self.fine.with_edges(start)
        edged = edged.with_misfit(edged.candidate(start.point))
        look = edged.look(edged.candidate(start.point), start.temperature)
        for T in fine_cooling(edged.photographs):
            if start.temperature >= T:
                colder = self._cooled(edged, 3, look, T)
                if colder is look:
                    return level, start
                look = colder
        return edged, look

    def descended(self, level: ResolutionLevel, stage: int, look: Look, T: float) -> Look:
        """Return the end of a descent, which counts as a visit of a stage."""
        look = descend(level, look, T)
        self.visit(stage, look)
        return look

    def _cooled(self, level: ResolutionLevel, stage: int, look: Look, T: float) -> Look:
        """Return the end of a descent, or its start where the prior forbids the end or one before.

        Photographs that move the parameters farther than chance errs in measured values show
        something that the scene lacks: they count for less.
        """
        if look.temperature > 2 * T or self._is_far(look, T):
            return look
        colder = self.descended(level, stage, look, T)
        return look if self._is_far(colder, T) else colder

    def _is_far(self, look: Look, T: float) -> bool:
        first = HOTTEST * self.fine.photographs
        return first > T and trust.is_significant(look.penalty, len(look.point))


def edged_candidate(level: ResolutionLevel, candidate: Candidate) -> Candidate:
    """Return a candidate explained by all images that have the edges of its own."""
    return level.with_edges(candidate).candidate(candidate.point)


def _is_scene(candidate: Candidate) -> bool:
    return bool(candidate.explanations)


def _distinct(looks: Sequence[Look]) -> list[Look]:
    """Return looks without those in the valley of an earlier one, by the first one's curvature."""
    curvature, kept = looks[0].curvature(), [looks[0]]
    for look in looks[1:]:
        steps = [look.point - other.point for other in kept]
        if min(step @ curvature @ step for step in steps) > 2**2 * NEGLIGIBLE:
            kept.append(look)
    return kept


def _with_misfit(
    level: ResolutionLevel, looks: Sequence[Look]
) -> tuple[ResolutionLevel, list[Look]]:
    """Return the level whose noise is like the residual of the first look, and the looks there."""
    level = level.with_misfit(looks[0])
    return level, [level.look(level.candidate(x.point), x.temperature) for x in looks]
