"""Differencing and truncated singular values against dense algebra."""

import numpy as np
import pytest

from periscopy_sim.reconstruction.differencing import Differencing, neighbour_differences
from periscopy_sim.reconstruction.preconditioned import repair
from periscopy_sim.reconstruction.total_variation import prox_total_variation
from periscopy_sim.reconstruction.truncated_svd import TruncatedSVD
from tests.scenes import penumbrae
from tests.scenes.penumbrae import relative_error

PHOTOGRAPH = (20, 18)
HIDDEN = (5, 6)
M, N = 360, 30


A = penumbrae.transport(PHOTOGRAPH, HIDDEN, 0.5)


def photograph_of(image, noise=0.0, seed=0, A=A):
    """A f + noise, (rows, columns, 3); noise relative to the mean signal."""
    signal = A @ image.reshape(N, 3)
    signal += noise * signal.mean() * np.random.default_rng(seed).normal(size=signal.shape)
    return signal.reshape(*PHOTOGRAPH, 3)


def differencing(A=A, **options):
    return Differencing(A, photograph_shape=PHOTOGRAPH, hidden=HIDDEN, **options)


def truncated_svd(**options):
    return TruncatedSVD(A, hidden=HIDDEN, **options)


def test_differencing_minimizes_eq_2_with_the_weight_it_reports(minimizer):
    y = photograph_of(penumbrae.two_halves(HIDDEN), noise=2e-3)
    result = differencing(tolerance=1e-6).solve(y)
    D = published_d(PHOTOGRAPH)
    unit = np.linalg.norm(D @ A)
    for c in range(3):
        Dy, λ = D @ y.reshape(M, 3)[:, c], result.weight[c]
        expected = minimizer(Dy / unit, λ / unit**2, K=D @ A / unit, shape=HIDDEN, ρ=0.01)
        assert relative_error(result.image[..., c], expected) < 1e-3
    assert (result.residual <= 1e-6).all() and (result.iterations > 10).all()


def test_noiseless_photograph_gives_the_hidden_image():
    image = np.random.default_rng(3).random((*HIDDEN, 3))
    result = differencing().reconstruct(photograph_of(image))
    assert result.shape == (*HIDDEN, 3) and result.dtype == np.float64
    assert relative_error(result, image) < 1e-4


def test_weight_is_tv_weight_standard_deviations_of_the_noise_in_the_gram_form():
    y = photograph_of(penumbrae.two_halves(HIDDEN), noise=3e-3)
    DA, Dy = (published_d(PHOTOGRAPH) @ v for v in (A, y.reshape(M, 3)))
    _, squares, _, _ = np.linalg.lstsq(DA, Dy)
    noise = np.sqrt(squares / (len(DA) - N))
    result = differencing(tv_weight=1.7).solve(y)
    np.testing.assert_allclose(result.noise, noise, rtol=1e-6)
    np.testing.assert_allclose(result.weight, 1.7 * noise * np.linalg.norm(DA) / np.sqrt(N))


def test_with_wrapping_a_constant_background_enters_by_the_last_pixel_alone():
    y = photograph_of(penumbrae.two_halves(HIDDEN), noise=1e-3)
    method = differencing(tv_weight=0.0)
    change = method.reconstruct(y + 5.0) - method.reconstruct(y)
    expected = 5 * np.linalg.pinv(published_d(PHOTOGRAPH) @ A)[:, -1]
    assert np.linalg.norm(expected) > 0.1
    np.testing.assert_allclose(change[..., 0].ravel(), expected, rtol=1e-6)


@pytest.mark.parametrize(("fraction", "kept"), [(0.4, 12), (0.1, 3), (1e-3, 1), (1.0, 30)])
def test_truncated_svd_inverts_the_top_singular_values(fraction, kept):
    y = photograph_of(penumbrae.two_halves(HIDDEN), noise=2e-3)
    U, σ, Vt = np.linalg.svd(A, full_matrices=False)
    U, σ, Vt = U[:, :kept], σ[:kept], Vt[:kept]
    result = truncated_svd(fraction=fraction, tv_weight=0.5).solve(y)
    expected = Vt.T @ (U.T @ y.reshape(M, 3) / σ[:, None])
    assert relative_error(result.preconditioned.reshape(N, 3), expected) < 1e-6
    left = y.reshape(M, 3) - U @ U.T @ y.reshape(M, 3)
    np.testing.assert_allclose(result.noise, np.linalg.norm(left, axis=0) / np.sqrt(M - kept))
    covariance = Vt.T @ np.diag(σ**-2) @ Vt
    error = result.noise * np.sqrt(np.mean(np.diag(covariance)))
    np.testing.assert_allclose(result.weight, 0.5 * error, rtol=1e-6)


def test_truncated_svd_is_denoised_and_repaired_as_the_paper_s_method():
    y = photograph_of(np.random.default_rng(5).random((*HIDDEN, 3)), noise=2e-3)
    result = truncated_svd(repair_threshold=0.2).solve(y)
    denoised = prox_total_variation(result.preconditioned, result.weight)
    np.testing.assert_array_equal(result.denoised, denoised)
    threshold = 0.2 * np.percentile(np.sqrt(np.sum(denoised**2, axis=2)), 99)
    np.testing.assert_allclose(result.threshold, threshold)
    np.testing.assert_array_equal(result.image, repair(denoised, result.threshold))
    assert not np.array_equal(result.image, denoised)


def test_patches_that_cannot_be_told_apart_are_refused():
    twins = A.copy()
    twins[:, 7] = twins[:, 8]
    with pytest.raises(ValueError, match="full column rank"):
        Differencing(twins, photograph_shape=PHOTOGRAPH, hidden=HIDDEN).prepare()
    with pytest.raises(ValueError, match="fewer than 30 singular values"):
        TruncatedSVD(twins, hidden=HIDDEN, fraction=1.0).prepare()
    TruncatedSVD(twins, hidden=HIDDEN).prepare()


SHAPES = [(3, 2), (2, 3), (4, 4), (5, 1), (1, 5)]


def published_d(shape):
    """D over a photograph vectorized by columns, and the order of the row-major pixels in it."""
    order = [i * shape[1] + j for j in range(shape[1]) for i in range(shape[0])]
    D = np.zeros((len(order), len(order)))
    for k in range(len(order) - 1):
        D[k, order[k]], D[k, order[k + 1]] = -1, 1
    D[-1, order[-1]] = 1
    return D


@pytest.mark.parametrize("shape", SHAPES)
def test_difference_counts_only_if_both_pixels_are_used(shape):
    rng = np.random.default_rng(0)
    mask = rng.random(shape) < 0.7
    before = mask.copy()
    A = rng.normal(size=(mask.size, 4))
    D = published_d(shape)
    kept = ~(D != 0)[:, ~mask.ravel()].any(axis=1)
    for values in (A, A[:, 0]):
        whole = neighbour_differences(values.copy(), shape)
        np.testing.assert_allclose(whole, D @ values, atol=1e-15)
        for form in (mask, mask.ravel(), np.asfortranarray(mask)):
            found = neighbour_differences(values[mask.ravel()], shape, mask=form)
            np.testing.assert_allclose(found, D[kept] @ values, atol=1e-15)
    np.testing.assert_array_equal(mask, before)
