"""Noise and signal of a photograph, in closed form."""

import numpy as np
import pytest
from periscopy_sim.reconstruction.noise_aware.evidence import (
    LARGEST_RATIO,
    noise_of,
    noise_to_signal,
    root_mean_squares,
)

# Three patterns of curvatures 1, 4, 9 that are seen in the first three of 50 pixels, each by the
# root of its curvature; range(B) is the last two pixels.
ROOTS = np.array([1.0, 2.0, 3.0])
PIXELS, RANK = 50, 2


def of(y):
    return noise_of(y, ROOTS * y[:, :3], ROOTS**2, RANK)


def test_noise_is_what_the_patterns_leave_over_their_freedom():
    y = np.random.default_rng(0).standard_normal((3, PIXELS)) * [[1.0], [2.0], [0.5]]
    y[:, -RANK:] = 0
    expected = np.sqrt((y[:, 3:] ** 2).sum(axis=1) / (PIXELS - RANK - 3))
    np.testing.assert_allclose(of(y), expected, rtol=1e-12)


def test_channel_of_hardly_any_noise_is_not_believed():
    y = np.zeros((3, PIXELS))
    y[:, 10] = (1, 1e-9, 0)
    noise = of(y)
    np.testing.assert_allclose(noise[1:], noise[0] / LARGEST_RATIO)
    assert noise[0] == pytest.approx(1 / np.sqrt(45))


def test_noise_is_never_below_rounding():
    y = np.zeros((3, PIXELS))
    y[:, 0] = np.sqrt(PIXELS) * np.array([4.0, 2.0, 0.0])  # explained to the last digit
    np.testing.assert_allclose(of(y), 4e-7, rtol=1e-6)
    assert (of(np.zeros((3, PIXELS))) == 1e-30).all()


def test_one_pixel_more_than_unknowns_is_enough():
    y = np.ones((3, 4))
    np.testing.assert_allclose(noise_of(y, ROOTS * y[:, :3], ROOTS**2, 0), 1)
    np.testing.assert_allclose(noise_of(y, ROOTS * y[:, :3], ROOTS**2, 3), 1)


def test_noise_to_signal_is_the_ratio_of_energies():
    noise = np.array([0.1, 0.2, 0.3])  # 0.14 summed over the channels, of 3
    assert noise_to_signal(noise, 100, 0, 20) == pytest.approx(0.14 / 2.86)
    assert noise_to_signal(noise, 100, 50, 20) == pytest.approx(0.07 / 2.93)


def test_signal_is_at_least_its_own_standard_error():
    # 100 pixels of noise alone: the energy of 20 patterns in 3 channels has variance 2 · 60 σ⁴.
    assert noise_to_signal(np.ones(3), 100, 0, 20) == pytest.approx(300 / np.sqrt(120))
    assert noise_to_signal(2 * np.ones(3), 100, 0, 20) == pytest.approx(300 / np.sqrt(120))


def test_root_mean_squares_are_of_all_channels_of_a_photograph():
    planes = np.stack([np.full((3, 4), 2.0), np.diag([3.0, 4.0, 12.0, 0])[:3]])
    np.testing.assert_allclose(root_mean_squares(planes), [2, 13 / np.sqrt(12)])
