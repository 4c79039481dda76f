"""When a calibration is not to be believed, however small its errors."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from periscopy_sim.calibration.prior import Prior
from periscopy_sim.calibration.search.fisher_information import Curvature
from periscopy_sim.scenario import Array

FARTHEST = 3.0
"""Ruler's errors within which a ruler errs: all but 3 of 1000 times."""

MISFIT = 0.4
"""Part of what no smooth light makes, above which a structured residual is no small thing: in
simulations more than that was left beside near lamps, and the images were worse by 10 dB."""

NEGATIVE = 0.16
"""Part of the hidden image's light that may be negative where the residual is structured: in
simulations it was 0.2 to 1 beside near lamps, and at most 0.09 elsewhere, of pictures half black.
Of small bright things on black, in noise alone, it can be 0.3."""

CHANCE = 0.01
"""Of gaining as much where the ruler is right."""

LEARNED = 0.5
"""Of one parameter, in variance: a photograph that tells less than this of all tells nothing."""


def learned(about: Curvature) -> float:
    """Return how many parameters the photograph rather than the ruler determines, from 0 to P.

    The trace of I (I + Λ)⁻¹, of the information and the ruler's precision.
    """
    of_ruler = np.linalg.solve(about.invertible(), np.diag(about.prior.precision))
    return float(len(of_ruler) - np.trace(of_ruler))


def is_significant(gain: float, parameters: float) -> bool:
    """Tell whether a gain in evidence, over the start, is more than errors of the residual give.

    Where the start is right the gain of so many parameters has the χ² distribution (Wilks).
    """
    from scipy.stats import chi2

    return bool(gain > chi2.isf(CHANCE, max(parameters, 1.0)))


def bounded(covariance: Array, ruler: Array) -> Array:
    """Return a covariance, (P, P), with standard errors of at most the ruler's, (P,).

    A value comes from the ruler's, and is no worse known.
    """
    found = np.sqrt(np.diag(covariance))
    factors = np.minimum(found, ruler) / found
    return np.asarray(covariance * np.outer(factors, factors))


def doubts(
    names: Sequence[str],
    values: Array,
    middles: Array,
    spreads: Array,
    prior: Prior,
    gained: bool,
    known: float,
    misfit: float,
    negative: float,
) -> tuple[str, ...]:
    """Return why parameters, (P,), are not to be believed; empty where nothing says so.

    The box that was searched has half widths `spreads` about its `middles`, (P,) each. `gained`
    says whether they explain more than the start does, `known` how many of them the photograph
    determines, `misfit` what part of it no smooth light and no such scene makes, but for noise,
    `negative` what part of the hidden image's light is, 0 where what is left is but noise.
    """
    found = []
    for name, value, middle, spread, distance in zip(
        names, values, middles, spreads, prior.distance(values), strict=True
    ):
        if abs(distance) > FARTHEST:
            found.append(
                f"{name} ended {abs(distance):.1f} of the ruler's errors from where the ruler has "
                "it: the ruler, its error or the scene is wrong"
            )
        elif np.isinf(prior.errors).any() and abs(value - middle) > spread:
            found.append(f"{name} ended outside of what was searched, {middle:.4g} ± {spread:.2g}")
    if not gained and known < LEARNED:
        found.append(
            "the photograph tells less of the parameters than the ruler does: what it leaves "
            "unexplained hides them"
        )
    if misfit > MISFIT:
        found.append(
            f"of what no smooth light explains, {100 * misfit:.0f} % stay unexplained, and are no "
            "noise: a near lamp whose light no monitor-off photograph shows, a poster, a number "
            "that the ruler has far off, or something that the scene lacks"
        )
    if negative > NEGATIVE:
        found.append(
            f"{100 * negative:.0f} % of the light of the hidden image that explains most would be "
            "negative, and what is left is no noise: a near lamp's light "
            "may pass for the monitor's, or a number that the ruler has far off"
        )
    return tuple(found)
