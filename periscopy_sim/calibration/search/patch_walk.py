"""The same photograph one patch on: the evidence has a dip at each, and a descent is held by one.

Where an occluder moves shadows as a shift of the image does (`ImageShift.undone`), there is a place
for each whole patch that explains nearly as much, as there is where the monitor itself moves
(`ImageShift.by_patch`); between them the image, on a grid, cannot follow.
Slopes tell of these walls, not of how the dips compare, so the dips beside a descent's end are
looked at. One patch on the photograph looks the same, and so do its derivatives: a few renderings
find the bottom of a dip.
"""

from __future__ import annotations

from collections.abc import Callable

import numpy as np

from periscopy_sim.calibration.explanation.evidence import Explanation
from periscopy_sim.calibration.explanation.resolution_level import ResolutionLevel, Values
from periscopy_sim.calibration.search.image_shift import (
    BETWEEN_PATCHES,
    NEGLIGIBLE,
    between_patches,
)
from periscopy_sim.calibration.search.levenberg_marquardt import DAMPING, Descent
from periscopy_sim.errors import SceneError
from periscopy_sim.scenario import Array

TELLING = 100.0
"""Loss of evidence by which one patch is told from the next: what stays unexplained has favoured a
wrong patch by more than 30."""

CHORDS = 6
"""Steps to the bottom of a dip, at most; one that does not gain is halved."""

FARTHEST = 4
"""Patches walked, at most."""


def walk(
    level: ResolutionLevel,
    end: Descent,
    values: Values,
    seen: Explanation,
    patches: Array,
    looked: Callable[[], None] = lambda: None,
) -> tuple[Values, Explanation, Array]:
    """Walk from dip to dip while that gains; return where, what is seen there, and what is alike.

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
        (P, K) how far parameters move to the same photograph a patch on, see `ImageShift.undone`
        and `ImageShift.by_patch`.
    looked
        Called whenever a place was looked at.

    Returns
    -------
    values, seen
        Of the best dip.
    alike
        (P, K) those of the patches by which the next dip loses less than is telling; else 0.
    """

    def explain(at: Values) -> Explanation:
        found = level.explain(at)
        looked()
        return found

    for walked in range(FARTHEST + 1):
        beside = [
            [_dip(explain, end, values, sign * patch) for sign in (1, -1)] if patch.any() else []
            for patch in patches.T
        ]
        found = [dip for dips in beside for dip in dips if dip is not None]
        best = min(found, key=lambda dip: between_patches(level, *dip), default=(values, seen))
        gain = between_patches(level, values, seen) - between_patches(level, *best)
        if gain < BETWEEN_PATCHES * NEGLIGIBLE or walked == FARTHEST:
            break
        values, seen = best
    limit = seen.evidence + TELLING
    alike = [any(dip and dip[1].evidence < limit for dip in dips) for dips in beside]
    return values, seen, np.where(alike, patches, 0.0)


def _dip(
    explain: Callable[[Values], Explanation], end: Descent, values: Values, patch: Values
) -> tuple[Values, Explanation] | None:
    """Return the bottom of the dip a patch from some values, by chords, and what is seen there.

    None if it is not physical, or if there is no dip of its own: the chords lead back.
    """
    about, moved = end.curvature, end.curvature.jacobian.moved.mean(axis=0)

    def pull(seen: Explanation) -> Array:
        errors = seen.residuals / end.explanation.deviations
        return np.asarray(np.einsum("pmc,mc->p", moved, errors, optimize=True))

    volume = about.slope - about.prior.slope(end.values) + pull(end.explanation)

    def step(at: Values, seen: Explanation) -> Values:
        slope = volume - pull(seen) + about.prior.slope(at)
        return np.asarray(-np.linalg.solve(about.damped(DAMPING), slope))

    try:
        bottom, seen, part = values + patch, explain(values + patch), 1.0
        along = step(bottom, seen)
        for _ in range(CHORDS):
            tried = explain(bottom + part * along)
            gain = seen.evidence - tried.evidence
            if gain > 0:
                bottom, seen, part = bottom + part * along, tried, 1.0
                along = step(bottom, seen)
                if gain < NEGLIGIBLE:
                    break
            else:
                part /= 2
    except SceneError:
        return None
    metric = about.invertible() @ patch
    own = (bottom - values) @ metric > 0.5 * (patch @ metric)
    return (bottom, seen) if own else None
