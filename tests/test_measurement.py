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
@given(sbr=ratios, seed=st.integers(0, 1000), unit=scales, other=scales)
def test_composite_is_a_mixture_of_the_ratio_asked_for_and_of_unit_mean(sbr, seed, unit, other):
    signal, background = photographs(seed)
    total = composite(unit * signal, other * background, sbr)
    parts = np.stack([signal.ravel(), background.ravel()], axis=1)
    (a, b), residual, *_ = np.linalg.lstsq(parts, total.ravel())
    assert residual[0] < 1e-20 * total.size
    assert a * signal.mean() / (b * background.mean()) == pytest.approx(sbr, rel=1e-8)
    assert total.mean() == pytest.approx(1, rel=1e-13)


LIGHT, LAMP = photographs()


@pytest.mark.parametrize(
    ("call", "said"),
    [
        *((lambda sbr=sbr: composite(LIGHT, LAMP, sbr), "sbr") for sbr in (0.0, -1.0, np.nan)),
        *((lambda k=k: composite(0 * LIGHT + k, LAMP, 1), "positive mean") for k in (0, np.nan)),
        (lambda: composite(LIGHT, -LAMP, 1), "positive mean"),
        *((lambda snr=snr: add_noise(LIGHT, snr, 0), "snr") for snr in (np.nan, np.inf, -np.inf)),
    ],
)
def test_what_has_no_ratio_is_refused(call, said):
    with pytest.raises(ValueError, match=said):
        call()


@pytest.mark.parametrize(("snr", "scale"), [(-6.0, 1.0), (0.0, 1e6), (60.0, 1e-9)])
def test_noise_is_gaussian_of_the_stated_deviation(snr, scale):
    signal = scale * photographs(shape=(60, 60, 3))[0]
    noise = add_noise(signal, snr, 7) - signal
    np.testing.assert_array_equal(add_noise(signal, snr, 7) - signal, noise)
    assert (add_noise(signal, snr, 8) - signal != noise).mean() > 0.9
    root_mean_square = (sum(float(v) ** 2 for v in signal.flat) / signal.size) ** 0.5
    z = noise.ravel() / (10 ** (-snr / 20) * root_mean_square)
    # Each of the three fails by chance once in 10,000 seeds.
    low, high = stats.chi2.ppf([0.5e-4, 1 - 0.5e-4], z.size)
    assert low < np.sum(z**2) < high
    assert abs(z.mean()) < stats.norm.ppf(1 - 0.5e-4) / np.sqrt(z.size)
    assert stats.kstest(z, "norm").pvalue > 1e-4


def test_root_mean_square_of_bright_single_precision_does_not_overflow():
    bright = np.full((2, 2, 3), 1e30, np.float32)
    noise = add_noise(bright, 40, 0) - bright
    assert 1e27 < np.abs(noise).max() < 1e29


def test_noise_is_uncorrelated_across_pixels_and_channels():
    noise = add_noise(np.ones((80, 80, 3)), 20, 3) - 1
    bound = stats.norm.ppf(1 - 0.5e-4) / np.sqrt(79 * 80 * 2)
    for axis in range(3):
        ahead, behind = np.delete(noise, 0, axis).ravel(), np.delete(noise, -1, axis).ravel()
        assert abs(np.corrcoef(ahead, behind)[0, 1]) < bound
