"""The weighed problem in passes, against dense decompositions."""

import numpy as np
import pytest
from scipy import linalg

from periscopy_sim.hidden import Hidden
from periscopy_sim.model.ambient import background_basis
from periscopy_sim.model.transport_operator import TransportOperator
from periscopy_sim.reconstruction.iterative import Weighed
from periscopy_sim.reconstruction.preconditioned.preconditioner import form_preconditioner
from periscopy_sim.reconstruction.total_variation.prox import prox_total_variation
from tests.scenes.surfaces import alone, screen_and_column

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


def weighed(transport, count=3):
    return Weighed(transport, Hidden.of(SHAPE), *transport.strongest_eigenvectors(count))


def with_total_variation(transport, y, weight, count=3, **stop):
    """Minimize the weighed problem with a weight for each column."""
    stop = {"tolerance": 1e-6, "max_iterations": 5000} | stop
    return weighed(transport, count).minimize(transport.rmatmat(y), lambda *_: weight, **stop)


def test_account_of_the_end_is_what_the_dense_matrix_says():
    A, B, y = problem(decay=1e-2)
    transport = operator(A, B)
    solved = with_total_variation(transport, y, np.full(3, 0.1), max_iterations=3)
    dense = weighing(transport @ np.eye(N), 3) @ (transport @ np.eye(N))
    assert len(solved.path) == 3 and solved.path_of_last_third() == np.inf
    np.testing.assert_allclose(solved.product, dense.T @ dense @ solved.f, atol=1e-6)


def test_a_black_channel_stays_black_and_disturbs_no_other():
    A, B, y = problem(decay=1e-1)
    transport = operator(A, B)

    def solve(y):
        return with_total_variation(transport, y, np.full(y.shape[1], 0.01), tolerance=1e-9).f

    found = solve(y * [1, 0, 1])
    assert not found[:, 1].any()
    np.testing.assert_allclose(found[:, [0, 2]], solve(y[:, [0, 2]]), atol=1e-8)


def test_total_variation_of_an_isometry_is_the_proximal_operator():
    A, _, y = problem(decay=1)
    weight = np.array([0.05, 0.2, 1.0])
    solved = with_total_variation(TransportOperator(A), y, weight)
    expected = prox_total_variation((A.T @ y).reshape(*SHAPE, 3), weight, tolerance=1e-14)
    np.testing.assert_allclose(solved.f.reshape(*SHAPE, 3), expected, atol=1e-6)


def test_surfaces_that_light_other_pixels_are_recovered_as_each_alone():
    hidden = screen_and_column()
    random = np.random.default_rng(2)
    parts = [np.linalg.qr(random.normal(size=(40, each.patches)))[0] for each in alone(hidden)]
    y, weight = random.normal(size=(80, 3)), np.array([0.05, 0.2, 1.0])
    stop = {"tolerance": 1e-6, "max_iterations": 5000}

    def solved(A, y, hidden):
        transport = TransportOperator(A)
        problem = Weighed(transport, hidden, *transport.strongest_eigenvectors(3))
        return problem.minimize(A.T @ y, lambda *_: weight, **stop).f

    both = hidden.split(solved(linalg.block_diag(*parts), y, hidden))
    for one, A, light in zip(alone(hidden), parts, np.split(y, 2), strict=True):
        (name,) = one
        expected = one.split(solved(A, light, one))[name]
        np.testing.assert_allclose(both[name], expected, atol=1e-5)


def weighing(dense, count):
    """W in full: the strongest singular vectors weigh as much as the last of them."""
    U, σ, _ = np.linalg.svd(dense, full_matrices=False)
    U, factors = U[:, :count], σ[count - 1] / σ[:count]
    return np.eye(M) - (U * (1 - factors)) @ U.T


@pytest.mark.parametrize("count", [1, 4, N])
def test_weighed_problem_is_that_of_the_dense_matrix(count):
    A, B, y = problem(decay=3e-2)
    transport = operator(A, B)
    dense, rejected = transport @ np.eye(N), transport.project_out(y)
    W = weighing(dense, count)
    found = weighed(transport, count)
    h, f = transport.rmatmat(y), np.random.default_rng(3).normal(size=(N, 3))
    np.testing.assert_allclose(found.product(f), (W @ dense).T @ (W @ dense) @ f, atol=1e-6)
    np.testing.assert_allclose(found.data(h), (W @ dense).T @ (W @ rejected), atol=1e-6)
    np.testing.assert_allclose(
        found.energy(rejected, h), np.sum((W @ rejected) ** 2, axis=0), rtol=1e-6
    )
    largest = np.linalg.norm(W @ dense, 2) ** 2
    assert largest <= found.lipschitz < 1.01 * largest
    if count == N:
        np.testing.assert_allclose(found.start(h), form_preconditioner(A, B).apply(y), rtol=1e-6)


@pytest.mark.parametrize("count", [1, 4, N])
def test_minimum_is_that_of_dense_alternating_directions(count, minimizer):
    A, B, y = problem(decay=3e-2)
    transport = operator(A, B)
    weights = np.array([1e-2, 1e-1, 1.0])
    solved = with_total_variation(transport, y, weights, count)
    dense = transport @ np.eye(N)
    W = weighing(dense, count)
    for c, λ in enumerate(weights):
        rejected = W @ transport.project_out(y)[:, c]
        expected = minimizer(rejected, λ, K=W @ dense, shape=SHAPE, ρ=2 * λ).ravel()
        assert np.linalg.norm(solved.f[:, c] - expected) < 5e-4 * np.linalg.norm(expected)
