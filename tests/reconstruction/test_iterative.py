"""The hidden image by iterations, against the exact preconditioner and the dense problem."""

import numpy as np
import pytest

from periscopy_sim.model.ambient import background_basis
from periscopy_sim.reconstruction.iterative import IterativePeriscope
from periscopy_sim.reconstruction.preconditioned.preconditioner import form_preconditioner
from tests.scenes.blocks import Blocks

PHOTOGRAPH, HIDDEN = (20, 21), (5, 6)
M, N = 420, 30


def transport(seed=0):
    """A positive matrix, whose singular values fall by a hundred beside the uniform one."""
    rng = np.random.default_rng(seed)
    U, _ = np.linalg.qr(rng.normal(size=(M, N)))
    V, _ = np.linalg.qr(rng.normal(size=(N, N)))
    return ((U * np.geomspace(1, 1e-2, N)) @ V.T + 0.5).astype(np.float32)


A = transport()
B = np.random.default_rng(1).random((M, 3))
EDGE = np.where(np.arange(6) < 3, 0.9, 0.1)[None, :, None] * np.array([1.0, 0.6, 0.3])
TRUTH = np.broadcast_to(EDGE, (*HIDDEN, 3))


def photograph(noise=1e-3, seed=2):
    rng = np.random.default_rng(seed)
    y = A @ TRUTH.reshape(N, 3) + B @ rng.random((3, 3)) + noise * rng.normal(size=(M, 3))
    return y.reshape(*PHOTOGRAPH, 3)


def test_image_and_noise_are_those_of_the_dense_problem(minimizer):
    y = photograph().reshape(M, 3)
    solved = IterativePeriscope(A, B, hidden=HIDDEN, regularization=0.02).solve(y)
    Q = background_basis(B)
    dense, rejected = A - Q @ (Q.T @ A), y - Q @ (Q.T @ y)
    U, σ, _ = np.linalg.svd(dense, full_matrices=False)
    k = 3  # an eighth of the patches
    U, factors = U[:, :k], σ[k - 1] / σ[:k]
    W = np.eye(M) - (U * (1 - factors)) @ U.T
    K, b = W @ dense, W @ rejected
    residual = np.linalg.norm(b - K @ solved.image.reshape(N, 3), axis=0)
    np.testing.assert_allclose(solved.noise, residual / np.sqrt(M - 3 - k), rtol=1e-6)
    # 414 degrees of freedom: 4 standard errors are 14 %.
    np.testing.assert_allclose(solved.noise, 1e-3, rtol=0.14)
    expected = 0.02 * solved.noise * np.linalg.norm(dense)
    np.testing.assert_allclose(solved.weight, expected, rtol=1e-6)
    for c in range(3):
        minimum = minimizer(b[:, c], float(solved.weight[c]), K=K, shape=HIDDEN, ρ=0.02)
        error = np.linalg.norm(solved.image[..., c] - minimum)
        assert error < 1e-3 * np.linalg.norm(minimum)


@pytest.mark.thorough
def test_noise_is_estimated_without_bias():
    periscope = IterativePeriscope(A, B, hidden=HIDDEN)
    noise = np.array([periscope.solve(photograph(seed=seed)).noise for seed in range(20)])
    # 60 draws of χ² with some 400 degrees of freedom; the image takes up to 27 of them more.
    assert np.mean((noise / 1e-3) ** 2) == pytest.approx(1, abs=0.04)


@pytest.mark.thorough
@pytest.mark.parametrize("noise", [1e-4, 1e-3, 1e-2])
@pytest.mark.parametrize("tolerance", [1e-2, 1e-4])
def test_image_is_settled_where_the_iterations_stop(noise, tolerance):
    y = photograph(noise)
    settings = {"hidden": HIDDEN, "max_iterations": 20_000}
    found = IterativePeriscope(A, B, tolerance=tolerance, **settings).reconstruct(y)
    exact = IterativePeriscope(A, B, tolerance=1e-8, **settings).reconstruct(y)
    assert np.linalg.norm(found - exact) < tolerance * np.linalg.norm(exact)


def test_total_variation_recovers_an_edge_that_noise_hides_from_least_squares():
    solved = IterativePeriscope(A, B, hidden=HIDDEN).solve(photograph())
    exact = form_preconditioner(A, B).apply(photograph().reshape(M, 3)).reshape(*HIDDEN, 3)
    error = np.linalg.norm(solved.image - TRUTH)
    assert error < 0.25 * np.linalg.norm(exact - TRUTH)
    assert error < 0.1 * np.linalg.norm(TRUTH)
    assert solved.converged and solved.change <= 1e-3


def test_an_array_a_memory_map_and_blocks_give_the_same_image(tmp_path):
    np.save(tmp_path / "A.npy", A)
    mapped = np.load(tmp_path / "A.npy", mmap_mode="r")
    from_array, from_map, from_blocks = (
        IterativePeriscope(kind, B, hidden=HIDDEN).reconstruct(photograph())
        for kind in (A, mapped, Blocks(A))
    )
    np.testing.assert_array_equal(from_map, from_array)
    np.testing.assert_allclose(from_blocks, from_array, atol=1e-3)


def test_iterations_that_do_not_suffice_are_said_to():
    periscope = IterativePeriscope(A, B, hidden=HIDDEN, tolerance=1e-9, max_iterations=3)
    with pytest.warns(RuntimeWarning, match="stopped after 3 iterations"):
        solved = periscope.solve(photograph())
    assert not solved.converged and solved.change > 1e-9


def test_photographs_with_no_more_pixels_than_ambient_light_has_patterns_are_refused():
    with pytest.raises(ValueError, match="36 pixels"):
        IterativePeriscope(A[:36], np.eye(36)[:, :34], hidden=HIDDEN).prepare()


def test_pixels_that_determine_no_image_are_refused():
    few = slice(0, N + B.shape[1] - 1)
    with pytest.raises(ValueError, match="do not determine"):
        IterativePeriscope(A[few], B[few], hidden=HIDDEN).prepare()
