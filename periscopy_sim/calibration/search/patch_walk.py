"""The same photograph one patch on: the evidence has a dip at each, and a descent is held by one.

Where an occluder moves shadows as a warp of the image does (`image_warp`), there is a place for
each whole patch that explains nearly as much, as there is where the monitor itself moves
(`ImageShift.by_patch`); between them the image, on a grid, cannot follow.
Slopes tell of these walls, not of how the dips compare, so the dips beside a descent's end are
looked at. One patch on the photograph looks the same, and so do its derivatives: a few renderings
find the bottom of a dip.
"""

from __future__ import annotations

from collections import deque
from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from periscopy_sim.calibration.explanation.evidence import Explanation
from periscopy_sim.calibration.explanation.resolution_level import ResolutionLevel, Values
from periscopy_sim.calibration.search.image_shift import (
    BETWEEN_PATCHES,
    NEGLIGIBLE,
    between_patches,
)
from periscopy_sim.calibration.search.levenberg_marquardt import DAMPING, Descent
from periscopy_sim.calibration.search.physical_step import physical_step
from periscopy_sim.calibration.search.telling import worth
from periscopy_sim.errors import SceneError
from periscopy_sim.scenario import Array

TELLING = 100.0
"""Loss of evidence by which one patch is told from the next: what stays unexplained has favoured a
wrong patch by more than 30."""

CHORDS = 6
"""Steps to the bottom of a dip, at most; one that does not gain, or is not physical, is halved."""

MORE = 4.0
"""Times what a chord promises that a dip may gain yet."""

FARTHEST = 8
"""Patches walked, at most, in all directions together."""

NEAR = 0.25
"""Squared distance of two dips, over that to where they are seen from, at which they are one."""

SAME = 0.8
"""Squared cosine of the angle between two moves from which they lead to dips in one row."""

Dip = tuple[Values, Explanation]


@dataclass(frozen=True, eq=False)
class Walked:
    """Where a walk ended, and the dips beside.

    Attributes
    ----------
    values, seen
        (P,) the best dip's bottom, and what is seen there.
    alike
        (P, K) how far it is to the next dips that lose less than is telling.
    beside
        The bottoms of these dips, (P,) each, the best first; none twice.
    """

    values: Values
    seen: Explanation
    alike: Array
    beside: tuple[Values, ...]


def walk(
    level: ResolutionLevel,
    end: Descent,
    values: Values,
    seen: Explanation,
    patches: Array,
    looked: Callable[[], None] = lambda: None,
) -> Walked:
    """Walk from dip to dip, in one direction as long as that gains, then in the next.

    Of dips that the photograph hardly tells apart the ruler decides, see `between_patches`; what
    gains less than it is `worth` is not walked to.

    Parameters
    ----------
    level
        By whose rays evidences are compared.
    end
        Of the descent, with the derivatives.
    values, seen
        (P,) where it settled, and what is seen there.
    patches
        (P, K) how far parameters move to the same photograph a patch on, see
        `image_warp.undone` and `ImageShift.by_patch`.
    looked
        Called whenever a place was looked at.
    """

    def explain(at: Values) -> Explanation:
        found = level.explain(at)
        looked()
        return found

    sides = deque(
        (k, sign) for k in range(patches.shape[1]) if patches[:, k].any() for sign in (1, -1)
    )
    dips: dict[tuple[int, int], Dip | None] = {}
    walked, here = 0, explain(values) if sides else seen
    while len(dips) < len(sides):
        k, sign = sides[0]
        if (k, sign) not in dips:
            limit = seen.evidence + max(TELLING, level.prior.penalty(values) / BETWEEN_PATCHES)
            bottom = _dip(level, explain, end, values, sign * patches[:, k], limit)
            dips[k, sign] = None
            if bottom is not None:
                at, there = bottom
                dips[k, sign] = dip = at, level.judged(at)
                gain = between_patches(level, values, seen) - between_patches(level, *dip)
                least = worth(level, end.curvature, (values, here), (at, there))
                if walked < FARTHEST and gain > least:
                    dips, (values, seen), here = {(k, -sign): (values, seen)}, dip, there
                    walked += 1
                    continue  # the same way, while that gains
        sides.rotate(-1)
    telling = seen.evidence + TELLING
    near = [dip for dip in dips.values() if dip is not None and dip[1].evidence < telling]
    near.sort(key=lambda dip: between_patches(level, *dip))
    metric = end.curvature.invertible()
    beside = _single([at for at, _ in near], values, metric)
    alike = _distinct([at - values for at in beside], metric)
    return Walked(values, seen, alike, beside)


def _single(places: Sequence[Values], values: Values, metric: Array) -> tuple[Values, ...]:
    """Return places but those that lie much nearer to one before them than to some values."""

    def squared(move: Values) -> float:
        return float(move @ metric @ move)

    found: list[Values] = []
    for at in places:
        if all(squared(at - each) > NEAR * squared(at - values) for each in found):
            found.append(at)
    return tuple(found)


def _distinct(moves: Sequence[Values], metric: Array) -> Array:
    """Return of moves, (P,) each, those that are not much the same, or opposite: (P, K).

    The farther first, by a metric, (P, P): what leads to the same dip must not count twice.
    """
    found: list[Values] = []
    for move in sorted(moves, key=lambda move: -float(move @ metric @ move)):
        aside = [(move @ metric @ each) ** 2 / (each @ metric @ each) for each in found]
        if all(square < SAME * (move @ metric @ move) for square in aside):
            found.append(move)
    return np.array(found).reshape(len(found), len(metric)).T


def _dip(
    level: ResolutionLevel,
    explain: Callable[[Values], Explanation],
    end: Descent,
    values: Values,
    patch: Values,
    limit: float,
) -> Dip | None:
    """Return the bottom of the dip a patch from some values, by chords, and what is seen there.

    Chords are kept physical by `physical_step`. None if the dip is not physical, if there is no dip
    of its own, for the chords lead back, or if its evidence will hardly be below the limit.
    """
    about, moved = end.curvature, end.curvature.jacobian.moved.mean(axis=0)
    metric, damped = about.invertible() @ patch, about.damped(DAMPING)

    def pull(seen: Explanation) -> Array:
        errors = seen.residuals / end.explanation.deviations
        return np.asarray(np.einsum("pmc,mc->p", moved, errors, optimize=True))

    volume = about.slope - about.prior.slope(end.values) + pull(end.explanation)

    def step(at: Values, seen: Explanation) -> Values:
        slope = volume - pull(seen) + about.prior.slope(at)

        def of(free: NDArray[np.bool_]) -> Values:
            return np.asarray(-np.linalg.solve(damped[np.ix_(free, free)], slope[free]))

        return physical_step(level, at, of(np.ones(len(at), bool)), of)[0]

    def is_own(at: Values) -> bool:
        return bool((at - values) @ metric > 0.5 * (patch @ metric))

    def look(at: Values) -> Explanation | None:
        try:
            return explain(at)
        except SceneError:
            return None

    bottom, part = values + physical_step(level, values, patch, lambda free: patch[free])[0], 1.0
    if not is_own(bottom) or (seen := look(bottom)) is None:
        return None
    along = step(bottom, seen)
    for _ in range(CHORDS):
        promised = float(along @ damped @ along)
        if not is_own(bottom) or seen.evidence - MORE * promised > limit:
            return None
        tried = look(bottom + part * along)
        if tried is None or not tried.evidence < seen.evidence:
            part /= 2
            continue
        gain = seen.evidence - tried.evidence
        bottom, seen, part = bottom + part * along, tried, 1.0
        if gain < NEGLIGIBLE:
            break
        along = step(bottom, seen)
    return (bottom, seen) if is_own(bottom) and seen.evidence < limit else None
