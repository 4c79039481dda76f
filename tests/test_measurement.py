import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy import stats

from periscopy_sim.measurement import Sensor, add_noise, composite

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


@pytest.mark.parametrize("sbr", [0.0, -1.0, np.nan])
def test_ratio_that_is_not_positive_is_refused(sbr):
    with pytest.raises(ValueError, match="sbr"):
        composite(*photographs(), sbr)


@pytest.mark.parametrize("level", [0.0, -1.0, np.nan])
def test_photograph_without_a_positive_mean_is_refused(level):
    signal, background = photographs()
    dark = np.full(SHAPE, level)
    with pytest.raises(ValueError, match="positive mean"):
        composite(dark, background, 1.0)
    with pytest.raises(ValueError, match="positive mean"):
        composite(signal, dark, 1.0)


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


@pytest.mark.parametrize("snr", [np.nan, np.inf, -np.inf])
def test_snr_that_is_not_finite_is_refused(snr):
    with pytest.raises(ValueError, match="snr"):
        add_noise(photographs()[0], snr, 0)


def codes_of(sensor, values, light):
    """The mean codes that a sensor must have read, its mean light being `light`."""
    return values * sensor.electrons / light / sensor.step + sensor.black_level


@pytest.mark.parametrize(
    "sensor",
    [
        Sensor(electrons=40, read_noise=3, full_well=60, bit_depth=5),
        Sensor(electrons=5, read_noise=0, full_well=15, bit_depth=4),
        Sensor(electrons=0.3, read_noise=4, full_well=200, bit_depth=8),
        Sensor(electrons=900, read_noise=20, full_well=1000, bit_depth=8),
        Sensor(electrons=195, read_noise=16, full_well=200, bit_depth=6),
    ],
)
def test_codes_have_the_exact_distribution_of_photons_read_noise_and_rounding(sensor):
    exposure = sensor.expose(np.full((60, 60, 3), 7.0), 5)
    codes = np.rint(codes_of(sensor, exposure.values, 7.0)).astype(int)
    np.testing.assert_allclose(codes, codes_of(sensor, exposure.values, 7.0), atol=1e-8)
    n = np.arange(2000)
    photons = stats.poisson.pmf(n, sensor.electrons)
    bounds = (np.arange(sensor.top_code) + 0.5 - sensor.black_level) * sensor.step
    below = stats.norm.cdf(
        bounds, np.minimum(n, sensor.full_well)[:, None], max(sensor.read_noise, 1e-9)
    )
    probability = np.diff(photons @ below, prepend=0, append=1)
    expected = codes.size * probability
    counted = np.bincount(codes.ravel(), minlength=len(expected))
    assert counted[probability < 1e-12].sum() == 0
    # Codes of fewer than 8 expected values are counted as one; fails once in 10,000 seeds.
    rare = expected < 8
    pairs = [(counted[~rare], expected[~rare]), (counted[rare].sum(), expected[rare].sum())]
    χ2 = sum(np.sum((c - e) ** 2 / np.maximum(e, 1e-9)) for c, e in pairs if np.sum(e) > 1)
    assert χ2 < stats.chi2.ppf(1 - 1e-4, np.count_nonzero(~rare))


@pytest.mark.parametrize(
    "sensor",
    [
        Sensor(electrons=5000),
        Sensor(electrons=20, read_noise=6, frames=9),
        Sensor(electrons=1500, read_noise=1, full_well=8000, bit_depth=8),
        Sensor(electrons=2000, read_noise=30, full_well=9000, bit_depth=14, frames=4),
    ],
)
@pytest.mark.parametrize("light", [1e-6, 3e5])
def test_mean_and_variance_are_the_closed_form_and_so_is_the_snr(sensor, light):
    values = sensor.expose(np.full((70, 70, 3), light), 3).values.ravel() / light
    electrons = sensor.electrons
    step = sensor.full_well / (2**sensor.bit_depth - 1 - sensor.black_level)
    variance = (electrons + sensor.read_noise**2 + step**2 / 12) / sensor.frames / electrons**2
    # Each fails by chance once in 10,000 seeds: a few hundred photons and more are nearly normal.
    assert abs(values.mean() - 1) < stats.norm.ppf(1 - 0.5e-4) * np.sqrt(variance / values.size)
    low, high = stats.chi2.ppf([0.5e-4, 1 - 0.5e-4], values.size - 1) / (values.size - 1)
    kurtosis_room = 1 + 0.5 / (electrons * sensor.frames)
    assert low / kurtosis_room < values.var(ddof=1) / variance < high * kurtosis_room
    assert sensor.snr == pytest.approx(-10 * np.log10(variance), abs=1e-9)


@pytest.mark.parametrize(("read_noise", "bit_depth"), [(0.0, 8), (0.01, 16), (2.5, 12), (300.0, 4)])
def test_black_level_leaves_six_deviations_and_the_top_code_is_the_full_well(read_noise, bit_depth):
    sensor = Sensor(100, read_noise, full_well=4000, bit_depth=bit_depth)
    assert sensor.top_code == 2**bit_depth - 1
    assert sensor.black_level * sensor.step >= 6 * read_noise
    one_less = max(sensor.black_level - 1, 0)
    assert one_less * 4000 / (sensor.top_code - one_less) <= 6 * read_noise
    assert (sensor.top_code - sensor.black_level) * sensor.step == pytest.approx(4000)


def test_bright_values_saturate_at_the_full_well_and_are_counted_by_channel():
    photograph = np.ones((10, 10, 3))
    photograph[:4, :, 0], photograph[5, 5, 2] = 300, 1e20
    sensor = Sensor(electrons=50, read_noise=0, full_well=1000)
    exposure = sensor.expose(photograph, 1, reference=1.0)
    np.testing.assert_array_equal(exposure.saturated, [40, 0, 1])
    np.testing.assert_allclose(exposure.values[:4, :, 0], 1000 / 50)
    assert exposure.values[5, 5, 2] == exposure.values.max() == pytest.approx(20)
    assert exposure.values[:, :, 1].max() < 2


def test_values_that_read_noise_lifts_to_the_top_code_are_counted_too():
    sensor = Sensor(electrons=100, read_noise=16, full_well=200, bit_depth=6)
    photograph = np.full((100, 100, 3), 1.4)  # 140 electrons: 5 deviations below the full well
    exposure = sensor.expose(photograph, 0, reference=1.0)
    top = np.isclose(exposure.values, 2.0).sum(axis=(0, 1))
    np.testing.assert_array_equal(exposure.saturated, top)
    assert (top > 3).all()


def test_reference_keeps_the_exposure_of_several_photographs_the_same():
    bright, sensor = 3 * np.ones((50, 50, 3)), Sensor(electrons=1000, read_noise=0)
    variance = sensor.expose(bright, 0, reference=1.0).values.var()
    assert variance == pytest.approx(3 * 1000 / 1000**2, rel=0.1)
    assert sensor.expose(bright, 0).values.var() == pytest.approx(9 / 1000, rel=0.1)


def test_seed_alone_decides_an_exposure_and_the_photograph_is_kept():
    photograph, sensor = photographs()[1], Sensor(electrons=3000, frames=2)
    kept = photograph.copy()
    first = sensor.expose(photograph, 4).values
    np.testing.assert_array_equal(sensor.expose(photograph, 4).values, first)
    np.testing.assert_array_equal(photograph, kept)
    assert (sensor.expose(photograph, 5).values != first).mean() > 0.9
    single = sensor.expose(photograph.astype(np.float32), 4).values
    assert single.dtype == np.float64
    assert np.abs(single / first - 1).max() < 0.01


@pytest.mark.parametrize(
    ("name", "values"),
    [
        ("electrons", (0, -3, np.nan, 10_001)),
        ("full_well", (0, np.inf, np.nan)),
        ("read_noise", (-1, np.nan, 900)),
        ("bit_depth", (3, 33, 10.5)),
        ("frames", (0, 1.5, np.nan, np.inf)),
    ],
)
def test_sensor_that_cannot_be_is_rejected_by_name(name, values):
    for value in values:
        with pytest.raises(ValueError, match=rf"{name} {value}: give "):
            Sensor(**{"electrons": 100, name: value})


@pytest.mark.parametrize("light", [np.ones((4, 4)), np.full(SHAPE, -1e-9), np.full(SHAPE, np.inf)])
def test_light_that_cannot_be_exposed_is_rejected(light):
    with pytest.raises(ValueError, match="light to expose"):
        Sensor(electrons=100).expose(light, 0, 1.0)


@pytest.mark.parametrize("reference", [None, 0.0, -1.0, np.nan])
def test_exposure_by_no_light_is_rejected(reference):
    with pytest.raises(ValueError, match="must be positive, not"):
        Sensor(electrons=100).expose(np.zeros(SHAPE), 0, reference)
