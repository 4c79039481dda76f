"""Least squares with total variation against other minimizers and its own duality gap."""

import numpy as np
import pytest
from scipy import optimize

from periscopy_sim.reconstruction.total_variation.least_squares import (
    LeastSquares,
    minimize,
)

SHAPE = (5, 6)
M, N = 200, 30
WEIGHTS = [0.0, 0.1, 1.0, 10.0, 1e4]  # from none to a flat image


def ill_conditioned(seed=0, condition=300.0):
    """K with a wide spectrum, whose largest singular vector is nearly the uniform image."""
    rng = np.random.default_rng(seed)
    U, V = np.linalg.qr(rng.normal(size=(M, N)))[0], rng.normal(size=(N, N)) / 10
    V[:, 0] += 1
    σ = np.geomspace(1, 1 / condition, N)
    σ[0] = 3
    return (U * σ) @ np.linalg.qr(V)[0].T


def measured(K, noise=0.02, seed=1):
    """A flat patch on a ground, and its noisy measurement."""
    f = np.full(SHAPE, 0.2)
    f[1:4, 2:5] = 1.0
    rng = np.random.default_rng(seed)
    return f.ravel(), K @ f.ravel() + noise * rng.normal(size=M)


def problem_of(K):
    return LeastSquares(K.T @ K, np.linalg.cholesky(K.T @ K).T, SHAPE)


def slow_variation(f, ε=0.0):
    """Total variation in plain loops, each length √(d² + ε²) for a smooth one."""
    f = f.reshape(SHAPE)
    total = 0.0
    for i in range(SHAPE[0]):
        for j in range(SHAPE[1]):
            down = f[i + 1, j] - f[i, j] if i + 1 < SHAPE[0] else 0.0
            across = f[i, j + 1] - f[i, j] if j + 1 < SHAPE[1] else 0.0
            total += np.sqrt(down**2 + across**2 + ε**2)
    return total


def cost(f, K, b, weight):
    return np.sum((K @ f - b) ** 2) + weight * slow_variation(f)


def difference_matrices():
    """Differences down and across as (N, N) matrices."""
    index = np.arange(N).reshape(SHAPE)
    down, across = np.zeros((N, N)), np.zeros((N, N))
    for low, high in zip(index[:-1].ravel(), index[1:].ravel(), strict=True):
        down[low, [low, high]] = -1, 1
    for left, right in zip(index[:, :-1].ravel(), index[:, 1:].ravel(), strict=True):
        across[left, [left, right]] = -1, 1
    return down, across


def smoothed_minimum(K, b, weight):
    """Minimize with lengths √(d² + ε²) by L-BFGS, ε falling."""
    down, across = difference_matrices()
    f = np.linalg.lstsq(K, b)[0]
    for ε in 10.0 ** -np.arange(1, 7):

        def smooth(f, ε=ε):
            dx, dy = down @ f, across @ f
            length = np.sqrt(dx**2 + dy**2 + ε**2)
            residual = K @ f - b
            slope = 2 * K.T @ residual
            slope += weight * (down.T @ (dx / length) + across.T @ (dy / length))
            return residual @ residual + weight * length.sum(), slope

        options = {"maxiter": 3000, "maxfun": 6000, "ftol": 1e-15, "gtol": 1e-10, "maxcor": 40}
        f = optimize.minimize(smooth, f, jac=True, method="L-BFGS-B", options=options).x
    return f


def solved(K, b, weight, tolerance=1e-10, max_iterations=20_000):
    return problem_of(K).minimize(
        K.T @ b, weight, tolerance=tolerance, max_iterations=max_iterations
    )


@pytest.mark.parametrize("weight", [0.003, 0.03, 0.3])
def test_converged_image_is_the_minimum_that_another_minimizer_finds(weight):
    K = ill_conditioned(condition=30.0)
    _, b = measured(K)
    minimum = solved(K, b, weight)
    other = smoothed_minimum(K, b, weight)
    lowest, found = cost(other, K, b, weight), cost(minimum.f, K, b, weight)
    assert found <= lowest * (1 + 1e-9)
    assert found >= lowest * (1 - 1e-4)  # no sum of squares gone astray
    assert np.linalg.norm(minimum.f - other) < 1e-2 * np.linalg.norm(other)


@pytest.mark.parametrize("weight", WEIGHTS)
def test_no_neighbour_of_the_converged_image_costs_less(weight):
    K = ill_conditioned()
    _, b = measured(K)
    f = solved(K, b, weight, tolerance=1e-12).f
    least = cost(f, K, b, weight)
    rng = np.random.default_rng(2)
    directions = [np.ones(N), np.linalg.svd(K)[2][-1], *np.eye(N)[:5], *rng.normal(size=(40, N))]
    directions += [np.repeat([1.0, 0.0], [k, N - k]) for k in (6, 12, 18)]
    for direction in directions:
        for size in (1e-3, -1e-3, 1e-1, -1e-1):
            assert cost(f + size * direction, K, b, weight) >= least - 1e-10 * (b @ b)


@pytest.mark.parametrize("weight", [0.003, 0.03])
@pytest.mark.parametrize("iterations", [1, 7, 20, 60])
def test_gap_bounds_the_distance_to_the_minimum_at_every_stage(weight, iterations):
    K = ill_conditioned()
    _, b = measured(K)
    energy = np.sum((K @ np.linalg.lstsq(K, b)[0]) ** 2)
    early = solved(K, b, weight, tolerance=1e-16, max_iterations=iterations)
    best = solved(K, b, weight, tolerance=1e-13)
    excess = cost(early.f, K, b, weight) - cost(best.f, K, b, weight)
    assert early.iterations == iterations
    assert 0 < np.sum((K @ (early.f - best.f)) ** 2) <= excess + 1e-12 * energy
    assert excess <= early.gap * energy * (1 + 1e-6)


@pytest.mark.parametrize("tolerance", [1e-3, 1e-6, 1e-9])
def test_iteration_stops_at_the_first_gap_within_the_tolerance(tolerance):
    K = ill_conditioned()
    _, b = measured(K)
    minimum = solved(K, b, 0.03, tolerance=tolerance)
    assert 0 <= minimum.gap <= tolerance
    before = minimum.iterations - 20
    assert before == 0 or solved(K, b, 0.03, 1e-16, max_iterations=before).gap > tolerance


def test_without_weight_it_is_the_unregularized_least_squares():
    K = ill_conditioned()
    _, b = measured(K)
    np.testing.assert_allclose(solved(K, b, 0.0).f, np.linalg.lstsq(K, b)[0], rtol=1e-8)


def test_large_weight_leaves_the_uniform_image_that_fits_best():
    K = ill_conditioned()
    _, b = measured(K)
    level = np.linalg.lstsq(K.sum(axis=1, keepdims=True), b)[0][0]
    np.testing.assert_allclose(solved(K, b, 1e6).f, level, rtol=1e-10)


@pytest.mark.parametrize("shape", [(1, 1), (1, 2), (3, 1)])
def test_smallest_images_are_solved_too(shape):
    rng = np.random.default_rng(0)
    size = shape[0] * shape[1]
    K, f = rng.normal(size=(10, size)), rng.normal(size=size)
    problem = LeastSquares(K.T @ K, np.linalg.cholesky(K.T @ K).T, shape)
    minimum = problem.minimize(K.T @ (K @ f), 0.0, tolerance=1e-9, max_iterations=1000)
    np.testing.assert_allclose(minimum.f, f, rtol=1e-6)


def test_lipschitz_constant_is_the_largest_squared_gain_beside_the_uniform_image():
    K = ill_conditioned()
    uniform = K.sum(axis=1)
    beside = K - np.outer(uniform, uniform @ K) / (uniform @ uniform)
    largest = np.linalg.norm(beside, 2) ** 2
    assert largest < 0.9 * np.linalg.norm(K, 2) ** 2
    assert problem_of(K).without_mean.lipschitz == pytest.approx(largest, rel=1e-9)


def together(K, b, weights, **stop):
    """Minimize for columns of b at once, each with its weight."""
    stop = {"tolerance": 1e-4, "max_iterations": 5000} | stop
    λ = np.array(weights)
    return minimize(problem_of(K), K.T @ b, lambda *_: λ, np.zeros((N, len(λ))), **stop)


@pytest.mark.parametrize("condition", [3.0, 100.0, 1000.0])
@pytest.mark.parametrize("seed", [0, 1, 2])
def test_images_are_settled_where_the_iterations_stop(condition, seed):
    K = ill_conditioned(seed, condition)
    weights = [0.003, 0.03, 0.3]
    b = np.stack([measured(K, seed=seed + k)[1] for k in range(3)], axis=1)
    found = together(K, b, weights)
    assert found.error <= 1e-4
    for c, λ in enumerate(weights):
        exact = solved(K, b[:, c], λ, tolerance=1e-14).f
        assert np.linalg.norm(found.f[:, c] - exact) < 1e-4 * np.linalg.norm(exact)


def test_account_of_an_iterate_is_the_problems():
    K = ill_conditioned(condition=30.0)
    b = measured(K)[1][:, None]
    found = together(K, b, [0.03], max_iterations=7, tolerance=1e-12)
    assert found.iterations == len(found.path) == 7
    np.testing.assert_allclose(found.product, K.T @ K @ found.f, atol=1e-12)
    found = together(K, b, [0.03], tolerance=1e-10)
    np.testing.assert_allclose(found.divergence, found.product - K.T @ b, atol=1e-8)


def test_weight_follows_the_image_it_is_told_of():
    K = ill_conditioned(condition=30.0)
    b = measured(K)[1][:, None]
    h = K.T @ b

    def scaled(f, product):  # λ = 0.1 ‖K f − b‖
        return 0.1 * np.sqrt(np.sum(b * b, 0) + np.sum(f * (product - 2 * h), 0))

    settings = {"tolerance": 1e-8, "max_iterations": 5000}
    found = minimize(problem_of(K), h, scaled, np.zeros_like(h), **settings)
    λ = 0.1 * float(np.linalg.norm(K @ found.f - b))
    exact = solved(K, b[:, 0], λ, tolerance=1e-14).f
    assert np.linalg.norm(found.f[:, 0] - exact) < 1e-6 * np.linalg.norm(exact)
    again = minimize(problem_of(K), h, scaled, np.linalg.solve(K.T @ K, h), **settings)
    np.testing.assert_allclose(again.f, found.f, atol=1e-7)
