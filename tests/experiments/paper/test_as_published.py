"""The steps of [15] against a second implementation, and as a method."""

import numpy as np
import pytest

import periscopy_sim as ps
from experiments.paper.as_published import MOST, descend, descended
from periscopy_sim.reconstruction.total_variation import prox_total_variation
from tests.scenes import penumbrae
from tests.scenes.penumbrae import relative_error

PHOTOGRAPH, HIDDEN = (20, 18), (5, 6)


def photograph_of(A, noise):
    signal = A @ penumbrae.two_halves(HIDDEN).reshape(-1, 3)
    signal += noise * signal.mean() * np.random.default_rng(0).normal(size=signal.shape)
    return signal.reshape(*PHOTOGRAPH, 3)


def test_it_ends_at_its_cap_near_the_minimum():
    A = penumbrae.transport(PHOTOGRAPH, HIDDEN, 0.02)
    y = photograph_of(A, noise=1e-3)
    method = ps.Differencing(A, photograph_shape=PHOTOGRAPH, hidden=HIDDEN, tv_weight=0.1)
    image, iterations = descended(method, y)
    np.testing.assert_array_equal(iterations, MOST)
    assert 1e-4 < relative_error(image, method.reconstruct(y)) < 0.5


SHAPE = (5, 6)
PIXELS, PATCHES = 200, 30


def ill_conditioned(condition):
    """K with a wide spectrum, whose largest singular vector is nearly the uniform image."""
    rng = np.random.default_rng(0)
    U, V = (
        np.linalg.qr(rng.normal(size=(PIXELS, PATCHES)))[0],
        rng.normal(size=(PATCHES, PATCHES)) / 10,
    )
    V[:, 0] += 1
    σ = np.geomspace(1, 1 / condition, PATCHES)
    σ[0] = 3
    return (U * σ) @ np.linalg.qr(V)[0].T


def measured(K):
    """A noisy measurement of a flat patch on a ground."""
    f = np.full(SHAPE, 0.2)
    f[1:4, 2:5] = 1.0
    return K @ f.ravel() + 0.02 * np.random.default_rng(1).normal(size=PIXELS)


def by_steps(K, b, weight, **settings):
    start = np.linalg.lstsq(K, b)[0].reshape(SHAPE)
    return descend(K.T @ K, K.T @ b, start, weight, **settings)


def test_black_measurement_gives_a_black_image():
    image, iterations = by_steps(ill_conditioned(300), np.zeros(PIXELS), 0.0, unit=1.0, white=0.0)
    assert not image.any() and iterations == 11


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
def test_published_steps_are_those_of_a_second_implementation(white, scale, weight, most):
    K = ill_conditioned(condition=5.0)
    b, weight = white * measured(K), white * weight
    expected, iterations = published_solver(scale * K, scale * b, scale**2 * weight, white, most)
    found, own = by_steps(
        K, b, weight, unit=scale, white=white, most=most
    )  # later, rounding decides
    assert own == iterations
    assert (iterations < most) == (most == 1100)
    assert np.linalg.norm(found.ravel() - expected) < 1e-5 * np.linalg.norm(expected)
