"""Conjugate gradients and FISTA in passes, against decompositions and another solver."""

import numpy as np
import pytest

from periscopy_sim.reconstruction.background_subspace import background_basis
from periscopy_sim.reconstruction.baselines.fista import LeastSquares, converge
from periscopy_sim.reconstruction.large_scale.matrix_free import (
    least_squares,
    total_variation_least_squares,
)
from periscopy_sim.reconstruction.large_scale.transport_operator import (
    Eigenvectors,
    TransportOperator,
)
from periscopy_sim.reconstruction.preconditioned.preconditioner import form_preconditioner
from periscopy_sim.reconstruction.total_variation.prox import prox_total_variation

SHAPE = (5, 6)
M, N = 300, 30


def problem(seed=0, decay=1.0):
    """A of singular values from 1 to `decay`, backgrounds, photographs of three channels."""
    rng = np.random.default_rng(seed)
    U, _ = np.linalg.qr(rng.normal(size=(M, N)))
    V, _ = np.linalg.qr(rng.normal(size=(N, N)))
    A = (U * np.geomspace(1, decay, N)) @ V.T
    return A, rng.normal(size=(M, 4)), rng.normal(size=(M, 3))


def operator(A, B):
    return TransportOperator(A, background_basis(B))


@pytest.mark.parametrize("decay", [1, 1e-2, 1e-4])
def test_converged_least_squares_are_the_preconditioner_times_the_photograph(decay):
    A, B, y = problem(decay=decay)
    expected = form_preconditioner(A, B).apply(y)
    solved = least_squares(operator(A, B), y, tolerance=1e-14, max_iterations=5000)
    error = np.linalg.norm(solved.f - expected) / np.linalg.norm(expected)
    assert error < 1e-15 / decay**2 + 1e-12
    assert (solved.gradient <= 1e-14).all()


def test_as_many_iterations_as_distinct_singular_values_are_enough():
    A, _, y = problem(decay=1)
    assert least_squares(TransportOperator(A), y, tolerance=1e-12).iterations == 1
    A, _, y = problem(decay=0.5)
    assert least_squares(TransportOperator(A), y, tolerance=1e-12).iterations <= N


@pytest.mark.parametrize("count", [0, 5])
def test_account_of_the_end_is_what_the_dense_matrix_says(count):
    A, B, y = problem(decay=1e-2)
    transport = operator(A, B)
    # Any orthonormal vectors are a start, even if they are no eigenvectors.
    V = np.linalg.qr(np.random.default_rng(6).normal(size=(N, 5)))[0]
    crude = Eigenvectors(np.full(5, 0.3), V) if count else None
    solved = least_squares(transport, y, max_iterations=7, eigenvectors=crude)
    y = transport.reject_background(y)
    dense = transport @ np.eye(N)
    residual = y - dense @ solved.f
    h = dense.T @ y
    assert solved.iterations == 7
    np.testing.assert_allclose(solved.h, h, atol=1e-13)
    np.testing.assert_allclose(solved.misfit, np.sum(residual**2, axis=0), rtol=1e-11)
    gradient = np.linalg.norm(dense.T @ residual, axis=0) / np.linalg.norm(h, axis=0)
    np.testing.assert_allclose(solved.gradient, gradient, rtol=1e-9)
    freedom = M - 4 - 7 - count
    np.testing.assert_allclose(solved.noise, np.sqrt(np.sum(residual**2, 0) / freedom), rtol=1e-11)


def test_noise_is_estimated_without_bias():
    A, B, _ = problem(decay=1e-4)
    transport, noise = operator(A, B), 1e-3
    variances = []
    for seed in range(20):
        rng = np.random.default_rng(seed)
        y = A @ rng.random((N, 3)) + B @ rng.random((4, 3)) + noise * rng.normal(size=(M, 3))
        variances.append(least_squares(transport, y, settled=0.01).noise ** 2 / noise**2)
    # χ² of M − 4 − k degrees of freedom, where k is at most N: 60 draws of standard deviation 0.09.
    assert np.mean(variances) == pytest.approx(1, abs=4 * np.sqrt(2 / (M - 4 - N) / 60))


def test_stopping_where_the_noise_has_settled_beats_the_converged_least_squares():
    A, B, _ = problem(decay=1e-4)
    transport, rng = operator(A, B), np.random.default_rng(5)
    f = np.outer(np.linspace(0, 1, N), [1.0, 0.5, 0.2])
    y = A @ f + 1e-3 * rng.normal(size=(M, 3))
    stopped = least_squares(transport, y, settled=0.01)
    converged = least_squares(transport, y)
    assert stopped.iterations < converged.iterations
    assert np.linalg.norm(stopped.f - f) < 0.5 * np.linalg.norm(converged.f - f)


@pytest.mark.parametrize("solver", ["least squares", "total variation"])
def test_a_black_channel_stays_black_and_disturbs_no_other(solver):
    A, B, y = problem(decay=1e-1)
    black = y * [1, 0, 1]

    def solve(y):
        transport = operator(A, B)
        start = least_squares(transport, y)
        if solver == "least squares":
            return start.f
        weight = np.full(y.shape[1], 0.01)
        return total_variation_least_squares(
            transport,
            transport.strongest_eigenvectors(3),
            start.h,
            weight,
            start.f,
            image_shape=SHAPE,
            tolerance=1e-9,
            max_iterations=5000,
        ).f

    found = solve(black)
    assert not found[:, 1].any()
    np.testing.assert_allclose(found[:, [0, 2]], solve(y[:, [0, 2]]), atol=1e-7)


def test_total_variation_of_an_isometry_is_the_proximal_operator():
    A, _, y = problem(decay=1)
    weight = np.array([0.05, 0.2, 1.0])
    transport = TransportOperator(A)
    solved = total_variation_least_squares(
        transport,
        transport.strongest_eigenvectors(3),
        A.T @ y,
        weight,
        np.zeros((N, 3)),
        image_shape=SHAPE,
        tolerance=1e-10,
        max_iterations=5000,
    )
    expected = prox_total_variation((A.T @ y).reshape(*SHAPE, 3), weight, tolerance=1e-12)
    np.testing.assert_allclose(solved.f.reshape(*SHAPE, 3), expected, atol=2e-3)


@pytest.mark.parametrize("count", [1, 4, N])
def test_minimum_is_that_of_the_solver_with_a_gram_matrix(count):
    A, B, y = problem(decay=3e-2)
    transport = operator(A, B)
    P = form_preconditioner(A, B)
    y = P.reject_background(y)
    h, weight = P.A.T @ y, np.array([1e-3, 1e-2, 1e-1])
    eigenvectors = transport.strongest_eigenvectors(count)
    solved = total_variation_least_squares(
        transport,
        eigenvectors,
        h,
        weight,
        P.apply(y),
        image_shape=SHAPE,
        tolerance=1e-8,
        max_iterations=20_000,
    )
    # W in full: the strongest singular vectors weigh as much as the last of them.
    dense = transport @ np.eye(N)
    U, σ, _ = np.linalg.svd(dense, full_matrices=False)
    U, factors = U[:, :count], σ[count - 1] / σ[:count]
    weighing = np.eye(M) - (U * (1 - factors)) @ U.T
    K = weighing @ dense
    quadratic = LeastSquares(K.T @ K, np.linalg.cholesky(K.T @ K).T, SHAPE)
    for c, λ in enumerate(weight):
        minimum = converge(
            quadratic, K.T @ (weighing @ y[:, c]), λ, tolerance=1e-10, max_iterations=20_000
        )
        error = np.linalg.norm(solved.f[:, c] - minimum.f) / np.linalg.norm(minimum.f)
        assert error < 2e-3
    descent = np.sum((y - dense @ solved.f) ** 2, axis=0) - np.sum(y**2, axis=0)
    np.testing.assert_allclose(solved.descent, descent, rtol=1e-9)


def test_a_start_from_the_strongest_patterns_takes_fewer_iterations_to_the_same_end():
    A, B, y = problem(decay=1e-2)
    transport = operator(A, B)
    from_zero = least_squares(transport, y, tolerance=1e-12)
    eigenvectors = transport.strongest_eigenvectors(12)
    deflated = least_squares(transport, y, tolerance=1e-12, eigenvectors=eigenvectors)
    assert deflated.iterations < 0.9 * from_zero.iterations
    np.testing.assert_allclose(deflated.f, from_zero.f, rtol=1e-5, atol=1e-8)
    np.testing.assert_allclose(deflated.misfit, from_zero.misfit, rtol=1e-9)


def test_without_a_weight_the_steps_are_nesterovs():
    A, B, y = problem(decay=1e-1)
    transport = operator(A, B)
    dense = transport @ np.eye(N)
    G, h = dense.T @ dense, dense.T @ transport.reject_background(y)
    eigenvectors = transport.strongest_eigenvectors(1)
    L = 1.01 * eigenvectors.energy[0]
    f = z = np.zeros((N, 3))
    t = 1.0
    for _ in range(6):
        previous, f = f, z - (G @ z - h) / L
        following = (1 + np.sqrt(1 + 4 * t**2)) / 2
        z, t = f + (t - 1) / following * (f - previous), following
    solved = total_variation_least_squares(
        transport,
        eigenvectors,
        h,
        np.zeros(3),
        np.zeros((N, 3)),
        image_shape=SHAPE,
        tolerance=1e-12,
        max_iterations=6,
    )
    np.testing.assert_allclose(solved.f, f, rtol=1e-9, atol=1e-12)


def test_iterations_stop_where_they_are_told():
    A, B, y = problem(decay=1e-3)
    transport = operator(A, B)
    start = least_squares(transport, y, max_iterations=3)
    assert start.iterations == 3
    solved = total_variation_least_squares(
        transport,
        transport.strongest_eigenvectors(2),
        start.h,
        np.full(3, 1e-3),
        start.f,
        image_shape=SHAPE,
        tolerance=1e-12,
        max_iterations=4,
    )
    assert solved.iterations == 4 and solved.change > 1e-12
