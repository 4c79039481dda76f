"""The search from a coarse level to a fine one, and whether to believe what it finds."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from periscopy_sim.calibration.consider_analysis import (
    UncertainParameters,
    require_effect,
    sensitivity,
)
from periscopy_sim.calibration.explanation.discrepancy import STRUCTURED
from periscopy_sim.calibration.explanation.evidence import Explanation
from periscopy_sim.calibration.explanation.resolution_level import ResolutionLevel, Values, Visit
from periscopy_sim.calibration.parameters import scales_and_spreads
from periscopy_sim.calibration.progress import Progress
from periscopy_sim.calibration.result import Calibration, Parameter
from periscopy_sim.calibration.search.fisher_information import block_scores
from periscopy_sim.calibration.search.global_search import LATER, explore
from periscopy_sim.calibration.search.image_shift import NEGLIGIBLE, ImageShift
from periscopy_sim.calibration.search.patch_search import ITERATIONS, Best, search_patches
from periscopy_sim.calibration.search.patch_walk import TELLING
from periscopy_sim.calibration.search.ruled_starts import ends_from_ruler
from periscopy_sim.calibration.trust import bounded, doubts, is_significant, learned
from periscopy_sim.errors import PeriscopyError, PhotographError, SceneError
from periscopy_sim.scenario import Array

GAINS = 3
"""Times that the gain over the wall is found anew before a descent: it is linearized each time."""

MARGIN = 1.3
"""Times larger than by the linear theory that errors are told to be: valleys of the evidence are
curved, and so much was missing in simulations of an earlier version."""

ATTEMPTS = 4
"""Times that a search begins, at most, while its result is in doubt or leaves more than noise."""

WIDER = 4
"""Times as many places as usual that walks look at where the search may be wrong."""

SAME = 0.01
"""Of a parameter's step: ends of descents that are nearer than that are one."""

UNEVEN = 2.0
"""Times that what is left varies more over the wall than noise does, from which it is no noise."""

SHOWN = 100.0
"""Gain in evidence over a black monitor below which a photograph shows nothing of the scene."""


def calibrate_levels(
    levels: Sequence[ResolutionLevel],
    start: Values,
    held: UncertainParameters,
    progress: Callable[[float], None] | None = None,
    *,
    shift: ImageShift | None = None,
) -> Calibration:
    """Find the values of some levels' parameters, from a start, (P,); else see `calibrate`.

    The two levels, coarse and fine, are of the same photograph, parameters and prior.
    """
    coarse, fine = levels
    prior = fine.prior
    shift = shift or ImageShift.none(len(start))
    require_effect(coarse, start, held)
    scales, spreads = scales_and_spreads(coarse.differing(), start)
    steps = np.minimum(scales, prior.errors)
    ruled = bool(np.isfinite(prior.errors).all())
    log = Progress(len(start), ruled, ITERATIONS, progress)
    search = _Search(coarse, fine, start, steps, spreads, shift, ruled, log)
    found = search.from_ruler() if ruled else search.of_box()
    values, level, best = found.values, found.best.level, found.best
    # A ruler's error bounds how far another's may drag a parameter; the linear theory has no bound.
    moves = sensitivity(level, best.end, held)
    moves = np.clip(moves, -prior.errors[:, None], prior.errors[:, None])
    plain = level.as_it_comes()
    left_before, left = plain.explain(start), plain.explain(values)
    # A shift of the image that no ruler knows, nobody knows: it is anywhere that was searched.
    unknown = shift.alone & np.isinf(prior.errors)
    ruler = np.hypot(np.where(unknown, spreads, prior.errors), values - start)
    alone, covariance = _covariances(best, moves, ruler, shift.alone, found.set_back)
    deviations = np.sqrt(np.diag(covariance))
    log.report(1.0)
    columns = start, values, np.sqrt(np.diag(alone)), deviations, scales, spreads, prior.errors
    return Calibration(
        parameters=tuple(
            Parameter(name, *(float(number) for number in numbers), trusted=not found.doubts)
            for name, *numbers in zip(fine.names, *columns, strict=True)
        ),
        uncertain=held,
        moves=moves,
        correlation=covariance / np.outer(deviations, deviations),
        path=log.path(),
        noise_before=left_before.noise / level.scale,
        noise=left.noise / level.scale,
        residual_before=level.picture(left_before.residuals),
        residual=level.picture(left.residuals),
        gain=level.gain_of(found.seen),
        discrepancy=level.discrepancy,
        overdispersion=level.overdispersion,
        moved=found.gained,
        doubts=found.doubts,
    )


@dataclass(frozen=True, eq=False)
class _Found:
    """What a search found.

    Attributes
    ----------
    values, seen
        (P,) the ruler's if `set_back`, and what is seen there.
    best
        What was found best.
    gained
        Whether that explains more than the start does, by more than chance.
    doubts
        Why not to believe it.
    """

    values: Values
    seen: Explanation
    best: Best
    gained: bool
    set_back: bool
    doubts: tuple[str, ...]

    @property
    def may_be_wrong(self) -> bool:
        """Whether it is in doubt, or leaves what is no noise, as a search in a wrong place does."""
        left = self.best.level
        uneven = left.overdispersion > UNEVEN
        return bool(self.doubts) or left.discrepancy > STRUCTURED or uneven


@dataclass(frozen=True, eq=False)
class _Search:
    """A search of both levels, from a start, (P,); see `calibrate_levels`."""

    coarse: ResolutionLevel
    fine: ResolutionLevel
    start: Values
    steps: Values
    spreads: Values
    shift: ImageShift
    ruled: bool
    log: Progress

    def of_box(self) -> _Found:
        """Return what is found where no ruler knows some parameter; while it is in doubt, go on.

        The next search is of the box about where the last one ended: it comes nearer to a place
        that lies outside the first box. Of all that was found, the `better` is returned.
        """
        seed, visit = self.coarse.seed, self.log.at(self.coarse)
        values = explore(self.coarse, self.start, self.spreads, seed, visit)
        visit = self.log.at(self.fine)
        found = self.followed(values, visit)
        for attempt in range(1, ATTEMPTS):
            if not found.doubts:
                break
            about = found.best.values
            values = explore(
                self.coarse, about, self.spreads, seed + attempt, self.log.again(LATER)
            )
            try:
                other = self.followed(values, visit, about=about)
            except (SceneError, PhotographError):
                continue
            found = self.better(_comparable(self.fine, about), found, other)
            if not self.fresh([other.best.values], [about]):
                break
        return found

    def from_ruler(self) -> _Found:
        """Return what is found about the ruler's word; where that may be wrong, search on.

        That is while it is in doubt, or what it leaves is no noise. Then another coarse descent's
        end is followed that explains more; if there is none, the last walk is gone wider, and then
        descents from other places are looked at. Of what was followed, the `better` is returned.

        What makes the search from one end fail makes it go on from the next; if all fail, what the
        first one failed by is raised.
        """
        coarse = _comparable(self.coarse, self.start)
        ends = ends_from_ruler(coarse, self.start, self.steps, self.log.at(self.coarse))
        fine = _comparable(self.fine, self.start)
        visit = self.log.at(self.fine)
        begun: list[Values] = []
        failed: list[PeriscopyError] = []

        def follow(values: Values, wider: int = 1) -> _Found | None:
            begun.append(values)
            try:
                return self.followed(values, visit, wider)
            except (SceneError, PhotographError) as error:
                failed.append(error)
                return None

        starts = sorted([self.start, *ends], key=fine.judgement)
        found = next(filter(None, map(follow, starts)), None)
        if found is None:
            raise failed[0]
        widened = False
        for attempt in range(1, ATTEMPTS):
            if not found.may_be_wrong:
                break
            least = coarse.judgement(found.best.values) - TELLING
            ends = self.fresh(ends, begun)
            if widened and not any(coarse.judgement(end) < least for end in ends):
                drawn = ends_from_ruler(coarse, self.start, self.steps, self.log.again(), attempt)
                ends = self.fresh(drawn, begun)
            best = min(ends, key=coarse.judgement, default=None)
            if best is not None and coarse.judgement(best) < least:
                other = follow(best)
            elif not widened:
                widened, other = True, follow(found.best.values, WIDER)
            else:
                continue
            found = self.better(fine, found, other) if other else found
        return found

    def fresh(self, ends: Sequence[Values], begun: Sequence[Values]) -> list[Values]:
        """Return the ends, (P,) each, from which no search has begun."""
        near = SAME * self.steps
        return [end for end in ends if all((np.abs(end - at) > near).any() for at in begun)]

    def better(self, fine: ResolutionLevel, found: _Found, other: _Found) -> _Found:
        """Return the one of two that explains more, each by its own errors.

        The photograph counts against the ruler as what the better one leaves varies over the wall.
        Where the difference is negligible, it is the one that is believed, if one is.
        """
        level = fine.overdispersed(min(each.best.level.overdispersion for each in (found, other)))
        gain = level.judgement(found.values) - level.judgement(other.values)
        if bool(found.doubts) != bool(other.doubts) and abs(gain) < NEGLIGIBLE:
            return other if found.doubts else found
        return other if gain > 0 else found

    def followed(
        self, values: Values, visit: Visit, wider: int = 1, about: Values | None = None
    ) -> _Found:
        """Return what the fine level finds from some values, and whether to believe it.

        Its walks look at `wider` times as many places as usual. The values were found in the box
        `about` others, (P,), if not about the start.

        A SceneError says that the search left the physical, a PhotographError that nothing is seen.
        """
        names, start, prior = self.fine.names, self.start, self.fine.prior
        _require_shadows(self.coarse, values)
        level = _evened(self.fine, values)
        best = search_patches(level, values, self.steps, self.shift, visit, self.log.looked, wider)
        values, seen, level, end = best.values, best.seen, best.level, best.end
        if end.unphysical is not None:
            place = ", ".join(
                f"{name} = {v:.4g}" for name, v in zip(names, end.values, strict=True)
            )
            raise SceneError(
                f"the search left the physical, past {place}: {end.unphysical}; free less, or fix "
                "the one that went too far by -D"
            )
        before = level.judged(start)
        known = learned(end.curvature)
        gained = is_significant(before.evidence - seen.evidence, known)
        set_back = self.ruled and not gained
        if set_back:
            values, seen = start, before
        visit(values, seen.evidence)
        left = level.as_it_comes().explain(values).left
        structured = level.discrepancy > STRUCTURED
        misfit, negative = (left, seen.darker_than_black) if structured else (0.0, 0.0)
        middles = start if about is None else about
        why = (
            *doubts(names, values, middles, self.spreads, prior, gained, known, misfit, negative),
        )
        return _Found(values, seen, best, gained, set_back, why)


def _evened(level: ResolutionLevel, values: Values) -> ResolutionLevel:
    """Return a level whose wall's unevenness, as it shows at some values, is divided out.

    It begins with the gain that is found there. Images that may shine negatively would follow a
    strong gain, and lead to one that is upside down.
    """
    level.background(values)  # once for this level and all that are made of it
    found = level.of_nonnegative_images().explain(values)
    level = level.evened(found)
    for _ in range(GAINS):
        level = level.gained(found)
        found = level.of_nonnegative_images().explain(values)
    return level.gained(found)


def _comparable(level: ResolutionLevel, values: Values) -> ResolutionLevel:
    """Return a level by which ends of searches near some values, (P,), are compared."""
    return _evened(level, values).comparable(values)


def _require_shadows(level: ResolutionLevel, values: Values) -> None:
    """Check that something of the scene is seen at some values; else raise a PhotographError."""
    seen = level.explain(values)
    likelihood = seen.evidence - level.prior.penalty(values)
    if not seen.darkness - likelihood >= SHOWN:  # nor where nothing is a number
        raise PhotographError(
            "the photograph shows no shadows of this scene, wherever its parameters are; nothing "
            "can be learned from it"
        )


def _covariances(
    best: Best,
    moves: Array,
    ruler: Values,
    shifting: NDArray[np.bool_],
    set_back: bool,
) -> tuple[Array, Array]:
    """Return the parameters' covariances, (P, P): alone, and with what uncertain ones do to them.

    Both are `bounded`; `moves`, (P, U), are of `sensitivity`. Parameters that are `shifting`, (P,),
    the image alone are known by the ruler, and so the others, which move as they do, no better: a
    room that is moved as a whole looks the same. If `set_back`, all are the ruler's.
    """
    if set_back:
        as_ruler = np.diag(ruler**2)
        return as_ruler, bounded(as_ruler + moves @ moves.T, ruler)
    others, end, about = ~shifting, best.end, best.end.curvature
    found = np.zeros((len(ruler), len(ruler)))
    scores = block_scores(best.level, end.explanation, about.jacobian)
    told = about.of(others)
    found[np.ix_(others, others)] = MARGIN**2 * told.covariance([s[:, others] for s in scores])
    crossed = about.invertible()[np.ix_(others, shifting)]
    following = np.zeros((len(ruler), int(shifting.sum())))
    following[others] = -np.linalg.solve(told.invertible(), crossed)
    following[shifting] = np.eye(int(shifting.sum()))
    found += (following * ruler[shifting] ** 2) @ following.T + best.alike @ best.alike.T
    return bounded(found, ruler), bounded(found + moves @ moves.T, ruler)
