import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy import stats

from periscopy_sim.measurement import add_noise, composite

SHAPE = (13, 17, 3)
scales = st.floats(-12, 12).map(lambda exponent: 10.0**exponent)
ratios = st.floats(-3, 3).map(lambda exponent: 10.0**exponent)


def photographs(seed=0, shape=SHAPE):
    """A contrasty signal and a smooth background, in units of their own."""
    rng = np.random.default_rng(seed)
    return rng.exponential(3.0, shape), 50 + rng.random(shape)


@settings(deadline=None, max_examples=60)
@given(sbr=ratios, seed=st.integers(0, 1000))
def test_composite_is_a_mixture_of_the_ratio_asked_for_and_of_unit_mean(sbr, seed):
    signal, background = photographs(seed)
    total = composite(signal, background, sbr)
    parts = np.stack([signal.ravel(), background.ravel()], axis=1)
    (a, b), residual, *_ = np.linalg.lstsq(parts, total.ravel())
    assert residual[0] < 1e-20 * total.size
    assert a * signal.mean() / (b * background.mean()) == pytest.approx(sbr, rel=1e-8)
    assert total.mean() == pytest.approx(1, rel=1e-13)


@settings(deadline=None, max_examples=60)
@given(sbr=ratios, signal_scale=scales, background_scale=scales)
def test_units_of_signal_and_background_do_not_matter(sbr, signal_scale, background_scale):
    signal, background = photographs()
    np.testing.assert_allclose(
        composite(signal_scale * signal, background_scale * background, sbr),
        composite(signal, background, sbr),
        rtol=1e-13,
    )


def test_one_factor_holds_for_all_channels():
    signal, background = np.ones(SHAPE) * [1.0, 2.0, 3.0], np.ones(SHAPE) * [5.0, 1.0, 0.0]
    # Means 2 and 2: at SBR 2 the background counts half, and 1/3 restores the exposure.
    expected = [(1 + 2.5) / 3, (2 + 0.5) / 3, 3 / 3]
    np.testing.assert_allclose(composite(signal, background, 2.0), np.ones(SHAPE) * expected)


def test_composite_of_single_precision_is_computed_in_double():
    signal, background = (part.astype(np.float32) for part in photographs())
    total = composite(signal, background, 0.7)
    assert total.dtype == np.float64
    double = composite(signal.astype(np.float64), background.astype(np.float64), 0.7)
    np.testing.assert_array_equal(total, double)


def test_composite_leaves_its_inputs_unchanged():
    signal, background = photographs()
    kept = signal.copy(), background.copy()
    composite(signal, background, 0.5)
    np.testing.assert_array_equal((signal, background), kept)


@pytest.mark.parametrize("sbr", [0.0, -1.0, np.nan, np.inf])
def test_ratio_that_is_not_positive_is_refused(sbr):
    with pytest.raises(ValueError, match="ratio must be positive"):
        composite(*photographs(), sbr)


def test_photographs_of_different_shapes_are_refused():
    signal, background = photographs()
    with pytest.raises(ValueError, match=r"\(13, 17, 3\) and background \(13, 16, 3\)"):
        composite(signal, background[:, 1:], 1.0)


@pytest.mark.parametrize("level", [0.0, -1.0, np.nan])
def test_photograph_without_a_positive_mean_is_refused(level):
    signal, background = photographs()
    dark = np.full(SHAPE, level)
    with pytest.raises(ValueError, match="positive mean"):
        composite(dark, background, 1.0)
    with pytest.raises(ValueError, match="positive mean"):
        composite(signal, dark, 1.0)


@pytest.mark.parametrize("snr", [-6.0, 0.0, 20.0, 60.0])
@pytest.mark.parametrize("scale", [1e-9, 1.0, 1e6])
def test_noise_is_gaussian_of_the_stated_deviation(snr, scale):
    signal = scale * photographs(shape=(60, 60, 3))[0]
    noise = add_noise(signal, snr, 7) - signal
    root_mean_square = (sum(float(v) ** 2 for v in signal.flat) / signal.size) ** 0.5
    z = noise.ravel() / (10 ** (-snr / 20) * root_mean_square)
    # Each of the three fails by chance once in 10,000 seeds.
    low, high = stats.chi2.ppf([0.5e-4, 1 - 0.5e-4], z.size)
    assert low < np.sum(z**2) < high
    assert abs(z.mean()) < stats.norm.ppf(1 - 0.5e-4) / np.sqrt(z.size)
    assert stats.kstest(z, "norm").pvalue > 1e-4


def test_noise_is_uncorrelated_across_pixels_and_channels():
    flat = np.ones((80, 80, 3))
    noise = add_noise(flat, 20, 3) - flat
    bound = stats.norm.ppf(1 - 0.5e-4) / np.sqrt(79 * 80 * 2)
    for axis in range(3):
        ahead, behind = np.delete(noise, 0, axis).ravel(), np.delete(noise, -1, axis).ravel()
        assert abs(np.corrcoef(ahead, behind)[0, 1]) < bound


def test_twenty_decibels_are_a_factor_of_ten():
    signal = photographs()[0]
    strong, weak = (add_noise(signal, snr, 1) - signal for snr in (10, 30))
    np.testing.assert_allclose(strong, 10 * weak, rtol=1e-10, atol=1e-13)


def test_seed_alone_decides_the_noise():
    signal = photographs()[0]
    first = add_noise(signal, 30, 4)
    np.random.default_rng(4).random(1000)
    np.testing.assert_array_equal(add_noise(signal, 30, 4), first)
    assert not np.isclose(add_noise(signal, 30, 5), first).any(axis=2).all()


def test_noise_on_single_precision_and_counts_is_double_and_leaves_the_photograph():
    counts = np.arange(24, dtype=np.uint8).reshape(2, 4, 3)
    for photograph in (counts, counts.astype(np.float32)):
        kept = photograph.copy()
        noisy = add_noise(photograph, 30, 0)
        np.testing.assert_array_equal(noisy, add_noise(counts.astype(np.float64), 30, 0))
        np.testing.assert_array_equal(photograph, kept)


def test_root_mean_square_of_bright_single_precision_does_not_overflow():
    bright = np.full((2, 2, 3), 1e30, np.float32)
    noise = add_noise(bright, 40, 0) - bright
    assert 1e27 < np.abs(noise).max() < 1e29


@pytest.mark.parametrize("snr", [np.nan, np.inf, -np.inf])
def test_snr_that_is_not_finite_is_refused(snr):
    with pytest.raises(ValueError, match="must be finite"):
        add_noise(photographs()[0], snr, 0)
