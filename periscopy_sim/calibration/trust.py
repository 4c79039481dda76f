"""When not to believe a calibration, however small its errors."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from periscopy_sim.calibration.level import Look
from periscopy_sim.calibration.result import LEARNED
from periscopy_sim.scenario import Array

FARTHEST = 3.0
"""Standard deviations within which a ruler errs: all but 3 of 1000 times."""

MISFIT = 0.4
"""Fraction of the light that no smooth ambient light explains, above which too much of it stays
unexplained: simulated photographs beside near lamps left more, and their images were worse by
10 dB."""


def learned(look: Look, count: int) -> float:
    """Return how many of the first parameters the photographs determine, from 0 to `count`.

    The trace of I (I + Λ)⁻¹, of the information and the prior's precision, the gain over the wall
    unknown.
    """
    covariance = np.linalg.inv(look.curvature())[:count, :count]
    return float(count - np.sum(look.precision[:count] * np.diag(covariance)))


def is_significant(gain: float, parameters: float, chance: float = 0.01) -> bool:
    """Return whether a gain in the objective over the start is more than chance makes it.

    Where the start is right the gain of so many parameters has the χ² distribution (Wilks), and
    exceeds this threshold with a probability of `chance`.
    """
    from scipy.stats import chi2

    return bool(gain > chi2.isf(chance, max(parameters, 1.0)))


def doubts(names: Sequence[str], distances: Array, known: float, look: Look) -> tuple[str, ...]:
    """Return why not to believe parameters; empty where nothing says so.

    Parameters
    ----------
    names, distances
        (P) parameters, and how many of the prior's standard deviations each ended from its start.
    known
        How many of them the photographs determine.
    look
        The photographs at the end.
    """
    reasons = [
        f"{name} ended {abs(distance):.1f} standard errors from its measured value: the ruler, its "
        "error or the scene is wrong"
        for name, distance in zip(names, distances, strict=True)
        if abs(distance) > FARTHEST
    ]
    if known < LEARNED:
        reasons.append("the photograph tells less of the parameters than the ruler does")
    unexplained = max(each.unexplained for each in look.explanations)
    if unexplained > MISFIT:
        reasons.append(
            f"{100 * unexplained:.0f} % of the light that no far lamp explains stays unexplained: "
            "a near lamp, a poster on the wall, or something that the scene lacks"
        )
    return tuple(reasons)
