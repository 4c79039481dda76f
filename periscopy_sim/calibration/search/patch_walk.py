"""The same photograph one patch on: the evidence has a dip at each, and a descent is held by one.

Where an occluder moves shadows as a warp of the image does (`image_warp`), there is a place for
each whole patch that explains nearly as much, as there is where the monitor itself moves
(`ImageShift.by_patch`); between them the image, on a grid, cannot follow.
Slopes tell of these walls, not of how the dips compare, so the dips about a descent's end are
looked at, the ruler's favourites (`patch_lattice`). One patch on the photograph looks the same, and
so do its derivatives: a few renderings find the bottom of a dip.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass
from typing import NamedTuple

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
from periscopy_sim.calibration.search.patch_lattice import PatchLattice
from periscopy_sim.calibration.search.physical_step import physical_step
from periscopy_sim.calibration.search.telling import least_gain
from periscopy_sim.errors import SceneError
from periscopy_sim.scenario import Array

TELLING = 100.0
"""Loss of evidence by which one patch is told from the next: what stays unexplained has favoured a
wrong patch by more than 30."""

CHORDS = 6
"""Steps to the bottom of a dip, at most; one that does not gain, or is not physical, is halved."""

SHORTEST = 0.5
"""Part of a chord, at least."""

MORE = 4.0
"""Times what a chord promises that a dip may gain yet."""

PLACES, MOST = 4, 24
"""Places looked at in a walk, for each move, and at most."""

DIPS = 3
"""Of so many places, the dip's bottom is sought of the one that explains most, besides those in
whose direction none is sought."""

OBJECTION = 20.0
"""Of the ruler to a place, from which on it is left out: 200 of evidence would make up for it."""

SAME = 0.8
"""Squared cosine of the angle between a move and others from which on it leads along them."""


class Looked(NamedTuple):
    """Parameters, (P,), the evidence there and the residuals, (M, 3), of an explanation."""

    values: Values
    evidence: float
    residuals: Array


@dataclass(frozen=True, eq=False)
class Walked:
    """Where a walk ended, and the dips beside.

    Attributes
    ----------
    values, seen
        (P,) the best dip's bottom, and what is seen there.
    alike
        (P, K) how far it is to the next dips that lose less than is telling, in K directions.
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
    wider: int = 1,
) -> Walked:
    """Walk to the best dip about a descent's end that gains more than the `least_gain`.

    Of dips that the photograph hardly tells apart the ruler decides, see `between_patches`.

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
    wider
        Times as many places as usual are looked at.
    """

    def look(at: Values) -> Looked | None:
        try:
            found = level.explain(at)
        except SceneError:
            return None
        looked()
        return Looked(at, found.evidence, found.residuals)

    moves = patches[:, patches.any(axis=0)]
    if not moves.size:
        return Walked(values, seen, moves, ())
    lattice = PatchLattice(end.curvature, values, moves)
    starts = _by_evidence(map(look, _places(level, lattice, wider)))
    limit = seen.evidence + max(TELLING, level.prior.penalty(values) / BETWEEN_PATCHES)
    bottoms = _by_evidence(
        _bottom(level, look, end, lattice, at, seen.evidence, limit)
        for at in _likeliest(starts, lattice)
    )
    found = _single([at.values for at in bottoms], values, lattice)
    dips = sorted(
        ((at, level.judged(at)) for at in found), key=lambda dip: between_patches(level, *dip)
    )
    here = values, level.explain(values) if dips else seen
    for dip in dips:
        gain = between_patches(level, values, seen) - between_patches(level, *dip)
        if gain < BETWEEN_PATCHES * NEGLIGIBLE:
            break
        if gain > least_gain(level, end.curvature, here, (dip[0], level.explain(dip[0]))):
            dips.append((values, seen))
            values, seen = dip
            break
    telling = seen.evidence + TELLING
    near = [dip for dip in dips if dip[1].evidence < telling]
    near.sort(key=lambda dip: between_patches(level, *dip))
    beside = _single([at for at, _ in near], values, lattice)
    alike = _distinct([at - values for at in beside], lattice.root)
    return Walked(values, seen, alike, beside)


def _places(level: ResolutionLevel, lattice: PatchLattice, wider: int) -> tuple[Values, ...]:
    """Return the places that a walk looks at; of one that is not physical, what of the way is."""
    count = wider * min(PLACES * lattice.moves.shape[1], MOST)
    moves = lattice.favourites(count, OBJECTION) - lattice.values
    steps = [physical_step(level, lattice.values, move, move.__getitem__)[0] for move in moves]
    return _single([lattice.values + step for step in steps], lattice.values, lattice)


def _by_evidence(places: Iterable[Looked | None]) -> list[Looked]:
    """Return places, the best first, without those of which there is nothing to tell."""
    return sorted(filter(None, places), key=lambda at: at.evidence)


def _likeliest(starts: Sequence[Looked], lattice: PatchLattice) -> list[Looked]:
    """Return of places, the best first, those of whose dips the bottom is sought.

    A dip that looks much the same must not be missed for others that look more so.
    """
    found: list[Looked] = []
    for k, start in enumerate(starts):
        moves = [each.values - lattice.values for each in found]
        if k * DIPS < len(starts) or _is_elsewhere(
            start.values - lattice.values, moves, lattice.root
        ):
            found.append(start)
    return found


def _single(places: Sequence[Values], values: Values, lattice: PatchLattice) -> tuple[Values, ...]:
    """Return of places those in other dips than some values, one of each."""
    found: list[Values] = []
    for at in places:
        if all(lattice.are_apart(at, each) for each in (values, *found)):
            found.append(at)
    return tuple(found)


def _is_elsewhere(move: Values, others: Sequence[Values], root: Array) -> bool:
    """Return whether a move leads out of the row, or plane, that others lead along.

    Lengths are those of moves @ root, see `PatchLattice`.
    """
    along = root.T @ np.reshape(others, (-1, len(move))).T
    aside = root.T @ move
    aside = aside - along @ np.linalg.lstsq(along, aside, rcond=None)[0]
    return bool(np.sum(aside**2) > (1 - SAME) * np.sum((move @ root) ** 2))


def _distinct(moves: Sequence[Values], root: Array) -> Array:
    """Return of moves, (P,) each, those that lead elsewhere than the shorter ones: (P, K).

    What leads to dips in one row, or plane, must not count twice.
    """
    found: list[Values] = []
    for move in sorted(moves, key=lambda move: float(np.linalg.norm(move @ root))):
        if _is_elsewhere(move, found, root):
            found.append(move)
    return np.reshape(found, (len(found), len(root))).T


def _bottom(
    level: ResolutionLevel,
    look: Callable[[Values], Looked | None],
    end: Descent,
    lattice: PatchLattice,
    start: Looked,
    home: float,
    limit: float,
) -> Looked | None:
    """Return the bottom of the dip that a place is in, by chords kept physical.

    None if it is that of the lattice's own values, or if its evidence will hardly be below a limit,
    by what chords promise and by the rate at which it came nearer to that of the values so far.
    """
    about, moved = end.curvature, end.curvature.jacobian.moved.mean(axis=0)
    damped = about.damped(DAMPING)

    def pull(residuals: Array) -> Array:
        errors = residuals / end.explanation.deviations
        return np.asarray(np.einsum("pmc,mc->p", moved, errors, optimize=True))

    volume = about.slope - about.prior.slope(end.values) + pull(end.explanation.residuals)

    def chord(seen: Looked) -> Values:
        slope = volume - pull(seen.residuals) + about.prior.slope(seen.values)

        def of(free: NDArray[np.bool_]) -> Values:
            return np.asarray(-np.linalg.solve(damped[np.ix_(free, free)], slope[free]))

        return physical_step(level, seen.values, of(np.ones(len(slope), bool)), of)[0]

    def is_beside(at: Values) -> bool:
        return bool(lattice.are_apart(at, lattice.values))

    seen, part, along = start, 1.0, chord(start)
    for left in reversed(range(CHORDS)):
        if seen.evidence - MORE * float(along @ damped @ along) > limit:
            return None
        tried = look(seen.values + part * along)
        if tried is None or not tried.evidence < seen.evidence:
            part /= 2
            if part < SHORTEST:
                break
            continue
        if tried.evidence > limit:
            rate = (tried.evidence - home) / (seen.evidence - home)
            if (tried.evidence - home) * rate**left > limit - home:
                return None
        gain = seen.evidence - tried.evidence
        seen, part = tried, 1.0
        if gain < NEGLIGIBLE or not is_beside(seen.values):
            break
        along = chord(seen)
    return seen if is_beside(seen.values) and seen.evidence < limit else None
