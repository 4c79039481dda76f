"""How often the truth is within the reported errors, against how often it should be."""

from __future__ import annotations

from collections.abc import Callable, Sequence

import numpy as np
from numpy.typing import NDArray
from scipy.special import erf
from scipy.stats import norm

from experiments.studies.wrong_scenes.outcome import Outcome

Array = NDArray[np.float64]

ONE = float(erf(np.sqrt(0.5)))
"""Share of a normal distribution within one standard deviation."""

LEVELS = np.append(np.arange(0.02, 0.99, 0.02), ONE)
LEVELS.sort()

RUNS = 2000
"""Of imagined sets of draws, for a band that holds 95 % of them."""


def covered(z: Array, levels: Array = LEVELS) -> Array:
    """Return the shares of distances z, (..., K), in standard errors, within intervals, (..., L).

    An interval's level is the share of a normal distribution about its middle that it holds.
    """
    reach = norm.ppf((1 + levels) / 2)
    return np.asarray(np.mean(np.abs(z)[..., None, :] < reach[:, None], axis=-1))


def of_draws(
    outcomes: Sequence[Outcome], z_of: Callable[[Outcome], Array], levels: Array = LEVELS
) -> tuple[Array, Array]:
    """Return the mean of draws' coverage, (L,), and its standard error by how draws differ.

    What is covered in one draw goes together, so that draws are counted, not numbers or patches.
    The error of a single draw is not known: NaN.
    """
    shares = np.array([covered(z_of(outcome), levels) for outcome in outcomes])
    if len(shares) < 2:
        return shares[0], np.full(len(levels), np.nan)
    return shares.mean(axis=0), shares.std(axis=0, ddof=1) / np.sqrt(len(shares))


def expected_band(outcomes: Sequence[Outcome], levels: Array = LEVELS) -> tuple[Array, Array]:
    """Return where 95 % of coverages by draws lie, (L,) each, if standard errors are right.

    Were the numbers independent, it would be a binomial distribution's; they correlate as
    reported. So z is drawn from the normal distributions of the reported correlations.
    """
    rng = np.random.default_rng(0)
    runs = np.zeros((RUNS, len(levels)))
    for outcome in outcomes:
        variances, axes = np.linalg.eigh(outcome.correlation)
        root = axes * np.sqrt(np.maximum(variances, 0))
        imagined = rng.standard_normal((RUNS, len(variances))) @ root.T
        runs += covered(imagined, levels)
    low, high = np.percentile(runs / len(outcomes), [2.5, 97.5], axis=0)
    return low, high
