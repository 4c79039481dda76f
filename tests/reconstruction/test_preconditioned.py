from dataclasses import fields

import numpy as np
import pytest
from scipy import stats

from periscopy_sim.model.transport_operator import RANK_TOLERANCE
from periscopy_sim.reconstruction.preconditioned import (
    Periscope,
    Reconstruction,
    form_preconditioner,
    repair,
)
from periscopy_sim.reconstruction.total_variation import prox_total_variation
from tests.scenes import penumbrae
from tests.scenes.penumbrae import kept_basis, relative_error

PHOTOGRAPH = (20, 20)
HIDDEN = (5, 6)
M, N = 400, 30
OPACITIES = [1.0, 0.1, 0.02]  # of the occluder: condition numbers of about 30, 400 and 2000
TOLERANCES = [1e-2, 1e-8, 1e-12]


def transport(opacity=1.0):
    return penumbrae.transport(PHOTOGRAPH, HIDDEN, opacity)


def backgrounds():
    return penumbrae.backgrounds(PHOTOGRAPH, 64)


def pseudoinverse_top(A, Q):
    """[I 0] [A, s Q]^+, with s to balance the two."""
    s = np.linalg.norm(A) / max(Q.shape[1], 1) ** 0.5
    return np.linalg.pinv(np.hstack([A, s * Q]), rcond=1e-14)[: A.shape[1]]


def measurements(A, B, channels=3):
    """Hidden images and photographs of them drowned in background light."""
    rng = np.random.default_rng(2)
    f, e = rng.random((A.shape[1], channels)), rng.random((B.shape[1], channels))
    return f, A @ f + B @ e * (np.linalg.norm(A) / np.linalg.norm(B))


@pytest.mark.parametrize("opacity", OPACITIES)
@pytest.mark.parametrize("tolerance", TOLERANCES)
def test_p_is_the_top_of_the_pseudoinverse_of_a_beside_a_background_basis(opacity, tolerance):
    """It inverts A, and leaves of each background no more than the tolerance."""
    A, B = transport(opacity), backgrounds()
    P = form_preconditioner(A, B, rank_tolerance=tolerance)
    oracle = pseudoinverse_top(A, kept_basis(B, tolerance))
    photographs = np.hstack([measurements(A, B)[1], np.random.default_rng(3).normal(size=(M, 3))])
    for y in photographs.T:
        assert relative_error(P.apply(y), oracle @ y) < 1e-6
    assert relative_error(P.matrix(), oracle) < 1e-6
    np.testing.assert_allclose(P.matrix() @ A, np.eye(N), atol=1e-8)
    np.testing.assert_allclose(P.apply(A), np.eye(N), atol=1e-8)
    unit = B / np.linalg.norm(B, axis=0)
    # What lies outside the range kept is at most the first singular value dropped.
    bound = tolerance * np.linalg.norm(unit, 2) + 1e-11
    norm = np.linalg.norm(P.matrix(), 2)
    assert np.linalg.norm(P.apply(unit), axis=0).max() / norm < bound
    assert np.linalg.norm(P.matrix() @ unit, axis=0).max() / norm < bound


def test_p_inverts_an_a_whose_gram_matrix_has_lost_its_smallest_values():
    A = transport(1e-4)
    assert np.linalg.cond(A) > 1e5
    """Refined, without forming P; P itself serves in single precision."""
    P = form_preconditioner(A)
    np.testing.assert_allclose(P.matrix() @ A, np.eye(N), atol=1e-5)
    np.testing.assert_allclose(P.apply(A), np.eye(N), atol=1e-8)


def weighted_minimizer(A, B, ω):
    """Least-norm minimizer of Eq. 7, ‖P B‖² + ω ‖P A − I‖², by brute-force least squares."""
    stacked = np.vstack([B.T, ω**0.5 * A.T])
    target = np.vstack([np.zeros((B.shape[1], A.shape[1])), ω**0.5 * np.eye(A.shape[1])])
    return np.linalg.lstsq(stacked, target, rcond=1e-13)[0].T


def well_separated():
    rng = np.random.default_rng(4)
    return rng.random((M, N)), rng.random((M, 6))


@pytest.mark.parametrize("ω", [1e-3, 1.0, 1e3])
def test_the_weight_of_eq_7_is_inert_while_the_ranges_meet_only_in_0(ω):
    A, B = well_separated()
    assert relative_error(form_preconditioner(A, B).matrix(), weighted_minimizer(A, B, ω)) < 1e-9


def test_the_weight_of_eq_7_matters_where_the_ranges_meet_and_p_is_refused():
    A, B = well_separated()
    A[:, 3] = B @ np.arange(1.0, 7.0)
    light, heavy = (weighted_minimizer(A, B, ω) for ω in (1e-3, 1e3))
    assert relative_error(light[3], heavy[3]) > 0.9
    others = np.arange(N) != 3
    assert relative_error(light[others], heavy[others]) < 1e-9
    with pytest.raises(ValueError, match=r"not full column rank .* the noise-aware method"):
        form_preconditioner(A, B)


def test_patch_nearly_like_background_is_resolved_at_the_price_of_its_noise():
    A, B = well_separated()
    alone = form_preconditioner(A, B).noise_gain[3]
    A[:, 3] = B @ np.arange(1.0, 7.0) + 0.1 * A[:, 3]
    P = form_preconditioner(A, B)
    np.testing.assert_allclose(P.apply(A), np.eye(N), atol=1e-8)
    assert P.noise_gain[3] == pytest.approx(100 * alone, rel=1e-6)


@pytest.mark.parametrize("opacity", OPACITIES)
@pytest.mark.parametrize("with_background", [True, False])
def test_noise_gain_is_the_diagonal_of_p_times_its_transpose(opacity, with_background):
    A, B = transport(opacity), backgrounds() if with_background else None
    Q = kept_basis(B, RANK_TOLERANCE) if with_background else np.zeros((M, 0))
    oracle = pseudoinverse_top(A, Q)
    P = form_preconditioner(A, B)
    np.testing.assert_allclose(P.noise_gain, np.sum(oracle**2, axis=1), rtol=1e-6)
    np.testing.assert_allclose(P.noise_gain, np.diag(P.matrix() @ P.matrix().T), rtol=1e-6)


@pytest.mark.parametrize("B", [None, np.zeros((M, 0)), np.zeros((M, 4))])
def test_no_background_gives_the_pseudoinverse_of_a(B):
    A = transport(0.1)
    P = form_preconditioner(A, B)
    assert P.Q.shape == (M, 0)
    assert relative_error(P.matrix(), np.linalg.pinv(A)) < 1e-9
    y = np.random.default_rng(0).random(M)
    np.testing.assert_array_equal(P.project_out(y), y)


def scattered(seed, rows=M, columns=N):
    return np.random.default_rng(seed).random((rows, columns))


@pytest.mark.parametrize("seed", range(2))
def test_patch_that_is_a_sum_of_others_is_refused(seed):
    A = scattered(seed)
    A[:, 3] = A[:, 5] + 0.5 * A[:, 7]
    for B in (None, scattered(seed + 100, columns=6)):
        with pytest.raises(ValueError, match=r"not full column rank \(30 patches, 0 of them"):
            form_preconditioner(A, B)


@pytest.mark.parametrize("dark", [1, 3, N])
def test_patches_that_the_wall_does_not_see_are_refused_and_counted(dark):
    A = transport()
    A[:, :dark] = 0
    message = rf"\(30 patches, {dark} of them invisible from the wall\): use fewer patches"
    for B in (None, backgrounds()):
        with pytest.raises(ValueError, match=message):
            form_preconditioner(A, B)


def test_bad_arguments_are_rejected():
    A, B = transport(), backgrounds()
    with pytest.raises(ValueError, match="rows"):
        form_preconditioner(A[: N - 1])
    with pytest.raises(ValueError, match="rows"):
        form_preconditioner(A, B[1:])
    with pytest.raises(ValueError, match="tolerance"):
        form_preconditioner(A, B, rank_tolerance=1.0)
    for name, array in (("A", A), ("B", B)):
        array[7, 2] = np.nan
        with pytest.raises(ValueError, match=f"{name} must be finite"):
            form_preconditioner(*((A, B) if name == "A" else (transport(), B)))


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
