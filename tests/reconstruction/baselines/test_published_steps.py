"""The published steps of [15] against a second implementation, and what they leave."""

import numpy as np
import pytest

from periscopy_sim.reconstruction.baselines import published_steps
from periscopy_sim.reconstruction.baselines.published_steps import descend_as_published
from periscopy_sim.reconstruction.total_variation.prox import prox_total_variation
from tests.reconstruction.total_variation.test_least_squares import (
    SHAPE,
    N,
    cost,
    ill_conditioned,
    measured,
    problem_of,
    solved,
)


def test_black_measurement_gives_a_black_image():
    problem = problem_of(ill_conditioned())
    published = descend_as_published(problem, np.zeros(N), 0.0, unit=1.0, white=0.0)
    assert not published.f.any() and published.iterations == 11


def published_solver(K, b, weight, white, most):
    """[15] with the data term ½‖K f − b‖² itself; its K and its image, in [0, 1], scaled so."""
    b = b / white

    def excess(change):
        """Return data(y + change) − data(y) − ∇data(y)·change.

        The difference of the two data terms themselves is lost in rounding where a change is small.
        """
        return 0.5 * np.sum((K @ change) ** 2)

    def norm(f):
        return np.linalg.norm(f.reshape(SHAPE), 2)

    def prox(f, λ):  # of λ‖f‖_TV beside ½‖f − g‖²
        return prox_total_variation(f.reshape(SHAPE), 2 * λ, tolerance=1e-6).ravel()

    λ = weight / 2 / white
    x_old = y = np.linalg.lstsq(K, b)[0]
    step, used, t = 1e-5, 1e-5, 1.0
    for iteration in range(1, most + 1):
        slope = K.T @ (K @ y - b)
        x = prox(y - step * slope, λ * used)
        while excess(x - y) > norm(x - y) ** 2 / (2 * step):
            step *= 0.3
            used = step
            x = prox(y - step * slope, λ * used)
        t_next = 0.5 * (1 + np.sqrt(1 + 4 * t**2))
        y = x + (t - 1) / t_next * (x - x_old)
        if iteration > 10 and norm(x - x_old) / x.size < 2.4e-6:
            break
        x_old, t, step = x, t_next, 5 * step
    return white * x, iteration


@pytest.mark.parametrize(("white", "scale"), [(1.0, 1.0), (1.0, 1e3), (40.0, 1e5)])
@pytest.mark.parametrize(("weight", "most"), [(1e-5, 1100), (1e-4, 1100), (1e-2, 30), (0.3, 30)])
def test_published_steps_are_those_of_a_second_implementation(
    white, scale, weight, most, monkeypatch
):
    monkeypatch.setattr(published_steps, "MOST_ITERATIONS", most)  # later, rounding decides
    K = ill_conditioned(condition=5.0)
    _, b = measured(K)
    b, weight = white * b, white * weight
    expected, iterations = published_solver(scale * K, scale * b, scale**2 * weight, white, most)
    minimum = descend_as_published(problem_of(K), K.T @ b, weight, unit=scale, white=white)
    assert minimum.iterations == iterations
    assert (iterations < most) == (most == 1100)
    assert np.linalg.norm(minimum.f - expected) < 1e-5 * np.linalg.norm(expected)


def test_published_steps_give_up_at_their_cap_where_the_problem_is_hard():
    K = ill_conditioned(condition=3000.0)
    _, b = measured(K)
    published = descend_as_published(problem_of(K), K.T @ b, 1e-3, unit=1e3, white=1.0)
    assert published.iterations == 1100
    best = solved(K, b, 1e-3, tolerance=1e-10)
    excess = cost(published.f, K, b, 1e-3) - cost(best.f, K, b, 1e-3)
    energy = np.sum((K @ np.linalg.lstsq(K, b)[0]) ** 2)
    assert 1e-8 * energy < excess <= published.gap * energy * (1 + 1e-6)


@pytest.mark.parametrize("weight", [1e-4, 1e-2, 1e-1])
def test_gap_of_the_published_steps_bounds_what_they_leave(weight):
    K = ill_conditioned(condition=5.0)
    _, b = measured(K)
    published = descend_as_published(problem_of(K), K.T @ b, weight, unit=1e3, white=1.0)
    best = solved(K, b, weight, tolerance=1e-12)
    energy = np.sum((K @ np.linalg.lstsq(K, b)[0]) ** 2)
    excess = (cost(published.f, K, b, weight) - cost(best.f, K, b, weight)) / energy
    assert excess <= published.gap * (1 + 1e-6)
    assert published.gap < 100 * excess
