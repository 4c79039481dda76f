"""When a calibration is not to be believed, however small its errors."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from periscopy_sim.calibration.information import Curvature
from periscopy_sim.calibration.prior import Prior
from periscopy_sim.scenario import Array

FARTHEST = 3.0
"""Ruler's errors within which a ruler errs: all but 3 of 1000 times."""

MISFIT = 0.4
"""Fraction of what no smooth light makes, above which a structured residual is too large: simulated
photographs beside near lamps left more, and their images were worse by 10 dB."""

NEGATIVE = 0.16
"""Fraction of the hidden image's light that may be negative where the residual is structured:
simulated photographs beside near lamps had 0.2 to 1, others at most 0.09."""

CHANCE = 0.01
"""Probability of gaining as much where the ruler is right."""

LEARNED = 0.5
"""Of one parameter, in variance: a photograph that tells less than this of all tells nothing."""


def learned(about: Curvature) -> float:
    """Return how many parameters the photograph rather than the prior determines, from 0 to P.

    The trace of I (I + Λ)⁻¹, of the information and the prior's precision.
    """
    of_prior = np.linalg.solve(about.damped(), np.diag(about.precision))
    return float(len(of_prior) - np.trace(of_prior))


def is_significant(gain: float, parameters: float) -> bool:
    """Return whether a gain in evidence, over the start, is more than chance makes it.

    Where the start is right the gain of so many parameters has the χ² distribution (Wilks).
    """
    from scipy.stats import chi2

    return bool(gain > chi2.isf(CHANCE, max(parameters, 1.0)))


def bounded(covariance: Array, ruler: Array) -> Array:
    """Return a covariance, (P, P), with standard errors of at most the ruler's, (P,).

    A value comes from the ruler's, and is no worse known.
    """
    errors = np.sqrt(np.diag(covariance))
    factors = np.minimum(errors, ruler) / errors
    return np.asarray(covariance * np.outer(factors, factors))


def doubts(
    names: Sequence[str],
    values: Array,
    spreads: Array,
    prior: Prior,
    gained: bool,
    known: float,
    misfit: float,
    negative: float,
) -> tuple[str, ...]:
    """Return why parameters, (P,), are not to be believed; empty where nothing says so.

    Places were sought within `spreads`, (P,), of the prior's centres. `gained` says whether the
    values explain more than the start does, `known` how many of them the photograph determines,
    `misfit` which fraction of it neither smooth light nor such a scene makes, `negative` which
    fraction of the hidden image's light is; both are 0 where the residual is noise.
    """
    found = []
    for name, value, middle, spread, distance in zip(
        names, values, prior.centers, spreads, prior.distance(values), strict=True
    ):
        if abs(distance) > FARTHEST:
            found.append(
                f"{name} ended {abs(distance):.1f} of the ruler's errors from its measured value: "
                "the ruler, its error or the scene is wrong"
            )
        elif not prior.is_known.all() and abs(value - middle) > spread:
            found.append(f"{name} ended outside of what was searched, {middle:.4g} ± {spread:.2g}")
    if not gained and known < LEARNED:
        found.append(
            "the photograph tells less of the parameters than the ruler does: the residual hides "
            "them"
        )
    if misfit > MISFIT:
        found.append(
            f"of what no smooth light explains, {100 * misfit:.0f} % stay unexplained, and are no "
            "noise: a near lamp whose light no --background shows, a poster (--mask), a number "
            "that the ruler has far off, or something that the scene lacks"
        )
    if negative > NEGATIVE:
        found.append(
            f"{100 * negative:.0f} % of the hidden image's light would be negative, and the "
            "residual is no noise: a near lamp whose light no --background shows may pass for the "
            "monitor's, or the ruler has a number far off"
        )
    return tuple(found)
