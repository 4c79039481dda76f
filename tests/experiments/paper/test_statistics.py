"""The statistics of the experiments on filters, noises and subspaces whose answers are known."""

import numpy as np
import pytest

from experiments.paper.fig10 import radial_spectrum, row_statistics
from experiments.published.ambient import outside


def test_difference_filter_ignores_uniform_light_and_opposes_its_neighbour():
    filters = np.zeros((2, 8, 8))
    filters[0, 3:5, 2] = -1, 1  # down
    filters[1, 3, 2:4] = -1, 1  # across
    found = row_statistics(filters)
    np.testing.assert_allclose(found.sum, 0, atol=1e-15)
    np.testing.assert_allclose(found.down, [-0.5, 0])
    np.testing.assert_allclose(found.across, [0, -0.5])
    np.testing.assert_allclose(found.opposite, 1 / 112)  # of 2 x 7 x 8 neighbouring pairs


def test_white_noise_has_neighbours_of_either_sign_and_a_flat_spectrum():
    rows = np.random.default_rng(0).normal(size=(64, 32, 32))
    found = row_statistics(rows)
    # 64 rows of 1984 pairs: five standard errors.
    assert abs(found.opposite.mean() - 0.5) < 5 * 0.5 / np.sqrt(64 * 1984)
    assert abs(found.down.mean()) < 5 / np.sqrt(64 * 992)
    frequency, power = radial_spectrum(rows, 0.01)
    assert frequency[1] == pytest.approx(1 / 0.32)
    # A ring of n coefficients over 64 rows scatters by about 1/sqrt(64 n / 2).
    np.testing.assert_allclose(power[4:], 1, atol=0.2)


def test_part_outside_a_subspace_is_found_beneath_independent_noise():
    rng = np.random.default_rng(1)
    Q = np.linalg.qr(rng.normal(size=(4000, 3)))[0]
    away = rng.normal(size=(4000, 3))
    away -= Q @ (Q.T @ away)
    within = Q @ rng.normal(size=(3, 3))
    b = within / np.linalg.norm(within) + 0.1 * away / np.linalg.norm(away)
    noisy = (b + 0.1 / np.sqrt(b.size) * rng.normal(size=b.shape) for _ in range(2))
    found = outside(Q, *(image.reshape(40, 100, 3) for image in noisy))
    assert found[0] == 1
    # One rendering alone would say 0.141; the product's error is about 0.1² / sqrt(12000).
    assert found[-1] == pytest.approx(0.1 / np.hypot(1, 0.1), rel=0.02)
