"""The linear equations of the noise-aware method against dense solutions."""

import pickle

import numpy as np
import pytest

from periscopy_sim.hidden import Hidden
from periscopy_sim.model.spectral_basis import (
    InverseLaplacian,
    Solver,
    SpectralBasis,
    cost,
    laplacian,
)
from periscopy_sim.model.transport_operator import TransportOperator
from tests.scenes.surfaces import screen_and_column

HIDDEN = Hidden.of((4, 5))
RNG = np.random.default_rng(0)
# Curvatures that fall by many powers of ten, as those of penumbrae do.
A = RNG.standard_normal((60, 20)) * 10.0 ** -np.linspace(0, 4, 20)
GRAM = A.T @ A
WEIGHTS = np.array([1.0, 0.5, 2.0])
RIGHT = RNG.standard_normal((3, 20))


def dense(ρ, data, g):
    K = laplacian(HIDDEN.differences).toarray()
    return np.array(
        [np.linalg.solve(w * GRAM + ρ * K, d + ρ * b)
         for w, d, b in zip(WEIGHTS, data, g, strict=True)]
    )  # fmt: skip


def solver(ρ, data, weak):
    patterns = SpectralBasis.of_gram(GRAM, HIDDEN)
    return Solver(patterns, WEIGHTS[:, None], ρ, data @ patterns.rows.T, weak)


@pytest.mark.parametrize("weak", [0.0, 0.01, 1.0, 1e12])
@pytest.mark.parametrize("ρ", [1e-3, 0.1, 10.0])
def test_equations_are_solved_whatever_counts_as_weak(weak, ρ):
    data = RNG.standard_normal((3, 20)) @ GRAM
    solve = solver(ρ, data, weak)
    for factor in (1, -2):
        g = (factor * RIGHT).astype(np.float32)
        expected = dense(ρ, data, g)
        assert np.abs(solve(g) - expected).max() < 1e-4 * np.abs(expected).max()


def test_sum_of_weak_patterns_that_is_kept_costs_their_part_of_the_change():
    ρ, data = 0.1, RNG.standard_normal((3, 20)) @ GRAM
    g = RIGHT.astype(np.float32)
    other = (RIGHT + 0.1 * RNG.standard_normal(RIGHT.shape)).astype(np.float32)
    errors = []
    for weak in (0.0, 1e-3, 1e-1):
        solve = solver(ρ, data, weak)
        solve(g)
        kept = solve(other, renew=False)
        expected = dense(ρ, data, other)
        change = np.linalg.norm(expected - dense(ρ, data, g))
        errors.append(np.linalg.norm(kept - expected) / change)
        assert errors[-1] < weak + 1e-4
        np.testing.assert_allclose(solve(other), expected, atol=1e-4 * np.abs(expected).max())
    assert errors[2] > 1e-3


@pytest.mark.parametrize(
    "hidden", [*map(Hidden.of, [(1, 1), (1, 7), (6, 1), (4, 5)]), screen_and_column()]
)
def test_inverse_laplacian_undoes_the_laplacian(hidden):
    images = RNG.standard_normal((3, hidden.patches))
    inverse = InverseLaplacian(hidden)
    smoothed = inverse((images @ laplacian(hidden.differences)).astype(np.float32))
    np.testing.assert_allclose(smoothed, images, atol=1e-5)
    copied = pickle.loads(pickle.dumps(inverse))
    np.testing.assert_array_equal(copied(smoothed), inverse(smoothed))


def test_laplacian_is_that_of_forward_differences():
    K = laplacian(HIDDEN.differences)
    for seed in range(3):
        f = np.random.default_rng(seed).random((4, 5))
        energy = (np.diff(f, axis=0) ** 2).sum() + (np.diff(f, axis=1) ** 2).sum() + (f**2).sum()
        assert f.ravel() @ K @ f.ravel() == pytest.approx(energy)
    np.testing.assert_array_equal(laplacian(Hidden.of((1, 1)).differences).toarray(), [[1.0]])


@pytest.mark.parametrize("hidden", [Hidden.of((9, 10)), screen_and_column()])
def test_strongest_patterns_are_those_of_the_whole_basis(hidden):
    rng, N = np.random.default_rng(3), hidden.patches
    Q = np.linalg.qr(rng.standard_normal((150, 2)))[0]
    A = rng.standard_normal((150, N)) * 10.0 ** -np.linspace(0, 4, N) + 10 * Q @ rng.random((2, N))
    operator = TransportOperator(A.astype(np.float32), Q)
    gram = operator.gram / (operator.squared_norm / N)
    whole = SpectralBasis.of_gram(gram, hidden)
    few = SpectralBasis.strongest(operator, hidden, N // 2)
    assert few.rows.shape == (N // 2, N) and not few.is_whole
    np.testing.assert_allclose(few.curvatures[-N // 4 :], whole.curvatures[-N // 4 :], rtol=0.02)
    W = few.rows.astype(np.float64)
    np.testing.assert_allclose(W @ laplacian(hidden.differences) @ W.T, np.eye(N // 2), atol=1e-5)
    largest = few.curvatures[-1]
    np.testing.assert_allclose(W @ gram @ W.T, np.diag(few.curvatures), atol=1e-5 * largest)
    # The equations, with the data of what is left out, against those of all patterns.
    d, g = rng.standard_normal((2, 3, N))
    d, ρ = d @ gram, 100 * few.curvatures[0]
    rest = d - d @ W.T @ W @ laplacian(hidden.differences)
    g = g.astype(np.float32)
    found = Solver(few, WEIGHTS[:, None], ρ, d @ W.T, 0.1, rest)(g)
    expected = Solver(whole, WEIGHTS[:, None], ρ, d @ whole.rows.T, 0.1)(g)
    assert np.linalg.norm(found - expected) < 0.02 * np.linalg.norm(expected)


def test_equal_numbers_give_equal_patterns():
    A = TransportOperator(RNG.standard_normal((60, 20)).astype(np.float32))
    one, other = (SpectralBasis.strongest(A, HIDDEN, 12) for _ in range(2))
    np.testing.assert_array_equal(one.rows, other.rows)


def test_cost_grows_with_the_patterns_alone():
    memory, seconds = zip(*(cost(10_000, n) for n in (6000, 12_000)), strict=True)
    assert memory[1] < 2 * memory[0] and seconds[1] == 2 * seconds[0]
