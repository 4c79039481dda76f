"""Predicted errors: against closed forms of estimates that are known."""

import numpy as np
import pytest
from periscopy_sim.reconstruction.noise_aware.predicted_error import (
    FARTHEST,
    best_factor,
    probes_of,
)

COUNT = 20000


@pytest.mark.parametrize("best", [0.3, 1.0, 2.7])
def test_shrinkage_of_least_error_is_found(best):
    """z/(1 + λ) of a signal of variance s² errs least where λ is σ²/s²."""
    rng = np.random.default_rng(0)
    variances = rng.uniform(0.5, 2, (2, COUNT))
    signal = rng.standard_normal((2, COUNT)) * np.sqrt(variances)
    z = signal + rng.standard_normal((2, COUNT)) * np.sqrt(variances)

    def estimate(z, factor):
        return z / (1 + factor / best)

    found = best_factor(estimate, z, variances, 1 / variances, probes_of(z.shape))
    # A parabola through octaves is off by some percent, chance by √(2/40000) of the error.
    assert found == pytest.approx(best, rel=0.12)


def test_threshold_is_near_that_of_the_actual_error():
    rng = np.random.default_rng(1)
    signal = np.where(rng.random(COUNT) < 0.1, 5.0, 0.0)
    z = signal + rng.standard_normal(COUNT)

    def estimate(z, factor):
        return np.sign(z) * np.maximum(np.abs(z) - factor, 0)

    thresholds = np.linspace(0.5, 3, 26)
    actual = [np.sum((estimate(z, threshold) - signal) ** 2) for threshold in thresholds]
    found = best_factor(estimate, z, np.ones(COUNT), np.ones(COUNT), probes_of((COUNT,)))
    assert np.sum((estimate(z, found) - signal) ** 2) < 1.05 * min(actual)


@pytest.mark.parametrize(("slope", "farthest"), [(1, -FARTHEST), (-1, FARTHEST)])
def test_search_ends(slope, farthest):
    """Where less is ever better, or more."""
    z = np.full(10, 100.0)

    def estimate(z, factor):
        return z + 10 + slope * np.log2(factor)

    assert best_factor(estimate, z, np.ones(10), np.ones(10), probes_of((10,))) == 2.0**farthest


def test_factor_does_not_jump_between_octaves():
    z = np.random.default_rng(2).standard_normal(1000)

    def chosen(best):
        def estimate(z, factor):
            return z + np.abs(np.log2(factor) - best)

        return best_factor(estimate, z, np.ones(1000), np.ones(1000), probes_of((1000,)))

    found = [chosen(best) for best in np.linspace(-1, 1, 81)]
    assert np.max(np.abs(np.diff(np.log2(found)))) < 0.1
