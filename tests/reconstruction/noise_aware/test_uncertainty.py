import numpy as np
import pytest

from periscopy_sim.reconstruction.noise_aware.still import NoiseAware
from periscopy_sim.reconstruction.noise_aware.uncertainty import standard_errors

RNG = np.random.default_rng(0)
HIDDEN = (6, 7)
A = RNG.random((400, 42))
TRUTH = np.zeros((*HIDDEN, 3))
TRUTH[1:4, 2:6] = (0.9, 0.5, 0.2)


def test_without_a_prior_to_speak_of_it_is_the_standard_error_of_least_squares():
    gram = A.T @ A
    noise = np.array([0.1, 0.2, 0.4])
    found = standard_errors(gram, noise, TRUTH, weight=1e-9)
    expected = np.sqrt(np.diag(np.linalg.inv(gram)))
    for channel, σ in enumerate(noise):
        np.testing.assert_allclose(found[..., channel].ravel(), σ * expected, rtol=1e-4)


def test_without_data_a_flat_image_is_unsure_by_the_priors_scale():
    # Two patches: differences of variance 2ε/λ, means that nothing tells.
    image = np.zeros((1, 2, 3))
    gram = 1e9 * np.array([[1.0, 1], [1, 1]])  # the sum alone is seen
    λ = 5.0
    found = standard_errors(gram, np.ones(3), image, λ)
    ε = 1 / λ
    # ½ (λ/2ε) d² is the exponent of the difference d, of which each patch has a half.
    np.testing.assert_allclose(found, np.sqrt(2 * ε / λ) / 2, rtol=1e-3)


def test_units_of_the_image_are_those_of_the_result():
    gram, noise = A.T @ A, np.full(3, 0.3)
    one = standard_errors(gram, noise, TRUTH, 20.0)
    other = standard_errors(gram / 100, noise, 10 * TRUTH, 2.0)
    np.testing.assert_allclose(other, 10 * one, rtol=1e-9)


@pytest.mark.parametrize("noise", [0.05, 0.1])
def test_errors_are_of_the_size_and_at_the_places_that_it_tells(noise):
    seen = A * np.geomspace(1, 0.02, 42)[np.random.default_rng(1).permutation(42)]
    method = NoiseAware(seen, hidden_shape=HIDDEN)
    errors, told = [], []
    for seed in range(40):
        y = seen @ TRUTH.reshape(-1, 3) + noise * np.random.default_rng(seed).normal(size=(400, 3))
        found = method.solve(y)
        errors.append(found.image - TRUTH)
        told.append(method.standard_errors(found))
    ratio = np.sqrt(np.mean((np.array(errors) / told) ** 2))
    assert 0.3 < ratio < 1.5
    actual = np.sqrt(np.mean(np.square(errors), axis=0)).ravel()
    expected = np.sqrt(np.mean(np.square(told), axis=0)).ravel()
    assert np.corrcoef(actual, expected)[0, 1] > 0.4
