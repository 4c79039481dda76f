from dataclasses import fields

import numpy as np
import pytest
from scipy import stats

from periscopy_sim.reconstruction.preconditioned.still import Periscope, Reconstruction, repair
from periscopy_sim.reconstruction.total_variation.prox import prox_total_variation
from tests.scenes import penumbrae
from tests.scenes.penumbrae import relative_error

PHOTOGRAPH = (20, 20)
HIDDEN = (5, 6)
M, N = 400, 30
LINEAR = {"tv_weight": 0.0, "repair_threshold": np.inf}
explicit_or_factored = pytest.mark.parametrize("explicit", [True, False])


A = penumbrae.transport(PHOTOGRAPH, HIDDEN, 0.5)
B = penumbrae.backgrounds(PHOTOGRAPH, 16)  # the tolerance keeps about as many dimensions


def photograph_of(image, noise=0.0, background=0.0, seed=0):
    """A f + B e + noise, (rows, columns, 3); background light and noise relative to the signal."""
    rng = np.random.default_rng(seed)
    signal = A @ image.reshape(N, 3)
    light = B @ rng.random((B.shape[1], 3))
    light *= background * signal.mean() / light.mean()
    y = signal + light + noise * signal.mean() * rng.normal(size=signal.shape)
    return y.reshape(*PHOTOGRAPH, 3)


def projected_pseudoinverse():
    """P and the dimension of [A, B] from NumPy's decompositions alone."""
    Q = penumbrae.kept_basis(B, 1e-10)
    return np.linalg.pinv(A - Q @ (Q.T @ A)), N + Q.shape[1]


@explicit_or_factored
@pytest.mark.parametrize("background", [0.0, 1.0, 100.0])
def test_piecewise_constant_image_is_recovered_from_a_noiseless_photograph(explicit, background):
    periscope = Periscope(A, B, hidden=HIDDEN, explicit=explicit)
    result = periscope.reconstruct(
        photograph_of(penumbrae.two_halves(HIDDEN), background=background)
    )
    assert result.shape == (*HIDDEN, 3)
    assert result.dtype == (np.float32 if explicit else np.float64)
    assert relative_error(result, penumbrae.two_halves(HIDDEN)) < (1e-4 if explicit else 1e-6)


@explicit_or_factored
@pytest.mark.parametrize("B", [B, None], ids=["backgrounds", "pseudoinverse"])
def test_noise_is_estimated_within_its_statistical_error(explicit, B):
    periscope = Periscope(A, B, hidden=HIDDEN, explicit=explicit)
    freedom = M - (N if B is None else projected_pseudoinverse()[1])
    σ = np.array([0.01, 0.03, 0.002])
    clean = photograph_of(penumbrae.two_halves(HIDDEN), background=B is not None)
    rng = np.random.default_rng(4)
    variances = np.array(
        [
            periscope.solve(clean + σ * rng.normal(size=clean.shape)).noise ** 2 / σ**2
            for _ in range(60)
        ]
    )
    # Chi-squared; each photograph, and their mean, fails by chance once in 10,000 seeds.
    low, high = stats.chi2.ppf([0.5e-4 / 180, 1 - 0.5e-4 / 180], freedom) / freedom
    assert low < variances.min() and variances.max() < high
    low, high = stats.chi2.ppf([0.5e-4, 1 - 0.5e-4], 180 * freedom) / (180 * freedom)
    assert low < variances.mean() < high


def test_weights_follow_the_estimates_noise_and_scale():
    pseudoinverse, _ = projected_pseudoinverse()
    periscope = Periscope(A, B, hidden=HIDDEN, tv_weight=0.7, repair_threshold=0.25, explicit=False)
    y = photograph_of(penumbrae.two_halves(HIDDEN), noise=1e-3, background=1.0) * [1.0, 0.5, 3.0]
    result = periscope.solve(y)
    gain = np.mean(np.sum(pseudoinverse**2, axis=1)) ** 0.5
    np.testing.assert_allclose(result.weight, 0.7 * gain * result.noise, rtol=1e-6)
    magnitudes = np.sort(np.sum(result.denoised**2, axis=2).ravel() ** 0.5)
    # The 99th percentile of 30 values lies 0.71 of the way from the second largest to the largest.
    percentile = magnitudes[-2] + 0.71 * (magnitudes[-1] - magnitudes[-2])
    assert result.threshold == pytest.approx(0.25 * percentile, rel=1e-9)


def test_standard_error_is_that_of_repeated_photographs():
    periscope = Periscope(A, B, hidden=HIDDEN, **LINEAR)
    clean = photograph_of(penumbrae.two_halves(HIDDEN), background=1.0)
    rng = np.random.default_rng(5)
    estimates = np.array(
        [periscope.reconstruct(clean + 0.01 * rng.normal(size=clean.shape)) for _ in range(100)]
    )
    measured = estimates.var(axis=0, ddof=1).reshape(N, 3)
    predicted = 1e-4 * periscope.preconditioner.noise_gain[:, None]
    # 90 chi-squared variances of 99 degrees of freedom: once in 10,000 seeds one lies outside.
    low, high = stats.chi2.ppf([0.5e-4 / 90, 1 - 0.5e-4 / 90], 99) / 99
    assert low < (measured / predicted).min() and (measured / predicted).max() < high


@explicit_or_factored
def test_stages_are_estimate_then_total_variation_then_repair(explicit):
    pseudoinverse, _ = projected_pseudoinverse()
    periscope = Periscope(A, B, hidden=HIDDEN, explicit=explicit)
    y = photograph_of(penumbrae.two_halves(HIDDEN), noise=3e-3, background=1.0) * [1.0, 0.5, 3.0]
    result = periscope.solve(y)
    estimate = (pseudoinverse @ y.reshape(M, 3)).reshape(*HIDDEN, 3)
    assert relative_error(result.preconditioned, estimate) < (1e-4 if explicit else 1e-7)
    denoised = prox_total_variation(result.preconditioned, result.weight)
    np.testing.assert_array_equal(result.denoised, denoised)
    np.testing.assert_array_equal(result.image, repair(denoised, result.threshold))
    np.testing.assert_array_equal(periscope.reconstruct(y), result.image)
    assert not np.array_equal(result.denoised, result.preconditioned)
    assert not np.array_equal(result.image, result.denoised)


@pytest.mark.parametrize(("noise", "tolerance"), [(1e-4, 1e-2), (1e-3, 1e-4), (1e-2, 1e-5)])
def test_explicit_and_factored_agree_but_for_rounding_beside_the_noise(noise, tolerance):
    fast, exact = (Periscope(A, B, hidden=HIDDEN, explicit=e) for e in (True, False))
    y = photograph_of(penumbrae.two_halves(HIDDEN), noise=noise, background=5.0)
    single, double = fast.solve(y), exact.solve(y)
    for field in fields(Reconstruction):
        error = relative_error(getattr(single, field.name), getattr(double, field.name))
        assert error < tolerance, field.name
