import itertools
import math

import numpy as np
import pytest
from scipy import optimize
from skimage.metrics import peak_signal_noise_ratio

from periscopy_sim.evaluation import metrics

SHAPE = (6, 8, 3)


def images(seed=0, shape=SHAPE):
    """A truth in [0, 1] and a noisy estimate of it, some of it negative, in a unit of its own."""
    rng = np.random.default_rng(seed)
    truth = rng.random(shape)
    return 40 * (truth - 0.2 + 0.2 * rng.normal(size=shape)), truth


def test_psnr_is_that_of_scikit_image_and_of_no_other_shape():
    estimate, truth = images()
    assert metrics.psnr(estimate, truth) == pytest.approx(
        peak_signal_noise_ratio(truth, estimate, data_range=1)
    )
    with pytest.raises(ValueError, match="shape"):
        metrics.psnr(estimate[..., :1], truth)


def test_colour_matched_psnr_forgives_any_mixture_of_colours():
    _, truth = images()
    mixed = truth @ np.array([[0.7, 0.2, 0], [0.25, 1, 0.3], [0.05, 0.3, 1.2]])
    assert metrics.colour_matched_psnr(mixed, truth) > 200 > metrics.psnr_gain_matched(mixed, truth)
    noisy = truth + 0.1 * np.random.default_rng(1).normal(size=truth.shape)
    assert metrics.colour_matched_psnr(noisy @ np.diag([1, 2, 3]), truth) == pytest.approx(
        metrics.colour_matched_psnr(noisy, truth)
    )


def loop_shift(image, down, right):
    """Shift by linear interpolation with zeros outside, one patch after the other."""
    rows, columns, _ = image.shape
    moved = np.zeros_like(image)
    for i, j in itertools.product(range(rows), range(columns)):
        y, x = i - down, j - right
        for k, m in itertools.product(range(rows), range(columns)):
            moved[i, j] += max(0, 1 - abs(y - k)) * max(0, 1 - abs(x - m)) * image[k, m]
    return moved


def loop_psnr(estimate, truth):
    """Gain per channel by search, then the peak signal-to-noise ratio for a peak of 1."""
    squares = 0.0
    for c in range(truth.shape[2]):
        positive = [max(v, 0.0) for v in estimate[..., c].flat]
        target = list(truth[..., c].flat)

        def misfit(gain, positive=positive, target=target):
            return sum((gain * p - t) ** 2 for p, t in zip(positive, target, strict=True))

        gain = optimize.minimize_scalar(misfit, tol=1e-12).x if any(positive) else 0.0
        squares += sum(
            (min(max(gain * p, 0), 1) - t) ** 2 for p, t in zip(positive, target, strict=True)
        )
    return 10 * math.log10(truth.size / squares)


@pytest.mark.parametrize("seed", range(5))
def test_gain_of_each_channel_fits_the_truth_best(seed):
    estimate, truth = images(seed)
    matched = metrics.gain_matched(estimate, truth)
    positive = np.where(estimate > 0, estimate, 0)
    for c in range(3):
        (gain,), *_ = np.linalg.lstsq(positive[..., c].reshape(-1, 1), truth[..., c].ravel())
        expected = np.minimum(gain * positive[..., c], 1)
        np.testing.assert_allclose(matched[..., c], expected, rtol=1e-12)
    assert matched.max() == 1 and matched.min() == 0


@pytest.mark.parametrize("level", [0.0, -1.0])
def test_channel_without_light_stays_black(level):
    estimate, truth = images()
    whole = metrics.gain_matched(estimate, truth)
    estimate[..., 1] = level
    matched = metrics.gain_matched(estimate, truth)
    np.testing.assert_array_equal(matched[..., 1], 0)
    np.testing.assert_array_equal(matched[..., [0, 2]], whole[..., [0, 2]])


@pytest.mark.parametrize(
    ("down", "right"), [(-2.0, 0.5), (-0.5, -1.75), (0.0, 0.0), (0.25, 3.0), (9.0, 0.5)]
)
def test_shift_interpolates_linearly_with_zeros_outside(down, right):
    image = images()[0]
    moved = metrics.shifted(image, down, right)
    np.testing.assert_allclose(moved, loop_shift(image, down, right), atol=1e-12)


def framed(seed=0):
    """A random image within a dark frame that no shift by 2 patches leaves."""
    truth = np.zeros((9, 11, 3))
    truth[2:-2, 2:-2] = np.random.default_rng(seed).random((5, 7, 3))
    return truth


@pytest.mark.parametrize(("down", "right"), [(-2, 0), (0, 2), (1, -1)])
def test_registration_undoes_a_shift_by_whole_patches(down, right):
    truth = framed()
    result = metrics.registered(5 * np.roll(truth, (down, right), axis=(0, 1)), truth)
    assert result.shift == (-down, -right)
    assert result.at_limit == (max(abs(down), abs(right)) == 2)
    assert result.psnr > 250
    np.testing.assert_allclose(result.image, truth, atol=1e-13)


def test_registration_is_the_best_of_the_whole_grid():
    estimate, truth = images()
    steps = [n / 2 for n in range(-4, 5)]
    scores = {
        (down, right): loop_psnr(loop_shift(estimate, down, right), truth)
        for down in steps
        for right in steps
    }
    best = max(scores, key=scores.get)
    result = metrics.registered(estimate, truth)
    assert result.shift == best
    assert result.psnr == pytest.approx(scores[best], abs=1e-6)
    error = np.mean((result.image - truth) ** 2)
    assert result.psnr == pytest.approx(-10 * math.log10(error), abs=1e-9)


def test_shares_within_standard_errors_are_those_of_normal_errors():
    rng = np.random.default_rng(8)
    truth = rng.uniform(0, 1, (60, 70, 3))
    errors = rng.uniform(0.2, 1, truth.shape)  # as large as the image
    image = [2, 3, 0.5] * (truth + errors * rng.standard_normal(truth.shape))
    found = metrics.covered(image, [2, 3, 0.5] * errors, truth)
    # 12,600 normal errors: 4 standard errors of a share, once in 16,000 seeds.
    assert found["covered_1"] == pytest.approx(0.6827, abs=0.017)
    assert found["covered_2"] == pytest.approx(0.9545, abs=0.008)
    assert metrics.covered(image, np.zeros_like(errors), truth)["covered_2"] == 0
