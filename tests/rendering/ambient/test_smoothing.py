import numpy as np
import pytest
from scipy import stats

from periscopy_sim.rendering import wall_polynomials
from periscopy_sim.rendering.ambient.background import SITES
from periscopy_sim.rendering.ambient.smoothing import best_estimate
from periscopy_sim.rendering.wall_polynomials import chosen_sites

SHAPE = (24, 20)


def axes(shape):
    rows, columns = ((np.arange(n) + 0.5) / n for n in shape)
    return (grid.ravel() for grid in np.meshgrid(rows, columns, indexing="ij"))


def monomials(shape, degree):
    """Products y^i x^j of total degree up to `degree`, (M, n)."""
    y, x = axes(shape)
    terms = [y**i * x**j for i in range(degree + 1) for j in range(degree + 1 - i)]
    return np.stack(terms, axis=1)


def polynomial(shape, degree, seed=0):
    basis = monomials(shape, degree)
    return basis @ np.random.default_rng(seed).normal(size=(basis.shape[1], 3))


def every_pixel(shape):
    return np.arange(shape[0] * shape[1])


def noisy(field, sigma, seed, K=8):
    return field + sigma * np.random.default_rng(seed).normal(size=(K, *field.shape))


def step(shape):
    """An edge of light that no polynomial follows; another height in each channel."""
    _, x = axes(shape)
    return 1 + np.outer(x > 0.45, [1.0, 2.0, 0.5])


@pytest.mark.parametrize("degree", range(13))
def test_polynomials_seen_at_a_few_sites_are_exact_at_every_pixel(degree):
    field = polynomial(SHAPE, degree)
    sites = chosen_sites(SHAPE, SITES)
    assert len(sites) < len(field) / 2
    found = best_estimate(np.stack([field[sites]] * 2), sites, SHAPE)
    assert found.replicas.shape == (2, 480, 3)
    np.testing.assert_allclose(found.replicas, np.stack([field] * 2), atol=1e-9)
    assert found.squared_bias.max() < 1e-18


@pytest.mark.parametrize("degree", [0, 2, 5])
def test_noise_on_a_polynomial_leaves_the_least_squares_fit_of_its_degree(degree):
    field = 5 * polynomial(SHAPE, degree)
    replicas = noisy(field, 0.3, degree)
    found = best_estimate(replicas, every_pixel(SHAPE), SHAPE)
    assert found.degree == degree
    basis = monomials(SHAPE, degree)
    expected = [basis @ np.linalg.lstsq(basis, samples, rcond=None)[0] for samples in replicas]
    np.testing.assert_allclose(found.replicas, expected, atol=1e-9)
    error = np.mean((found.replicas.mean(axis=0) - field) ** 2)
    assert error < 0.1 * 0.3**2 / 8


@pytest.mark.parametrize("sigma", [0.1, 1.0, 10.0])
def test_estimate_is_hardly_ever_worse_than_the_samples_and_knows_its_error(sigma):
    y, x = axes(SHAPE)
    fields = [
        step(SHAPE),
        polynomial(SHAPE, 3),
        np.stack([np.sin(9 * x), np.hypot(x - 0.4, y), np.exp(-30 * (x - y) ** 2)], axis=1),
    ]
    for field in fields:
        errors, told = [], []
        for seed in range(8):
            found = best_estimate(noisy(field, sigma, seed), every_pixel(SHAPE), SHAPE)
            errors.append(np.mean((found.replicas.mean(axis=0) - field) ** 2))
            told.append(found.squared_error)
        assert np.mean(errors) < 1.05 * sigma**2 / 8
        # Told rather too large: a squared bias that seems negative counts as none.
        assert 0.8 < np.mean(told) / np.mean(errors) < 4


def test_bias_is_estimated_without_bias(monkeypatch):
    monkeypatch.setattr(wall_polynomials, "MAX_DEGREE", 1)
    field, sites = step(SHAPE), chosen_sites(SHAPE, SITES)
    basis = monomials(SHAPE, 1)[sites]
    fit = basis @ np.linalg.lstsq(basis, field[sites], rcond=None)[0]
    truth = np.mean((fit - field[sites]) ** 2, axis=0)
    draws = [best_estimate(noisy(field, 0.5, seed)[:, sites], sites, SHAPE) for seed in range(400)]
    assert {draw.degree for draw in draws} == {1}
    biases = np.stack([draw.squared_bias for draw in draws])
    deviates = (biases.mean(axis=0) - truth) / (biases.std(axis=0, ddof=1) / np.sqrt(len(draws)))
    # As exact as the truth needs to be: the estimate's error is a few percent of it.
    assert np.all(biases.std(axis=0) / np.sqrt(len(draws)) < 0.03 * truth)
    assert np.abs(deviates).max() < stats.norm.isf(1e-5 / 6)


def test_field_with_an_edge_keeps_the_samples_themselves():
    replicas = noisy(step(SHAPE), 0.05, 0)
    found = best_estimate(replicas, every_pixel(SHAPE), SHAPE)
    assert found.degree is None
    assert found.replicas.tobytes() == replicas.tobytes()
    assert not found.squared_bias.any()


def test_edge_seen_at_a_few_sites_is_told_as_bias():
    sites = chosen_sites(SHAPE, SITES)
    found = best_estimate(noisy(step(SHAPE)[sites], 0.01, 0), sites, SHAPE)
    errors = np.mean((found.replicas.mean(axis=0) - step(SHAPE)) ** 2, axis=0)
    assert np.all(found.squared_bias > 0.1 * errors)


@pytest.mark.parametrize("shape", [(1, 1), (1, 7), (7, 1), (2, 2), (2, 3), (3, 2)])
def test_small_pictures_are_estimated(shape):
    field = np.random.default_rng(1).uniform(1, 2, size=(shape[0] * shape[1], 3))
    found = best_estimate(noisy(field, 1e-4, 2), every_pixel(shape), shape)
    np.testing.assert_allclose(found.replicas.mean(axis=0), field, atol=1e-3)
    flat = best_estimate(noisy(np.ones_like(field), 1e-4, 2), every_pixel(shape), shape)
    np.testing.assert_allclose(flat.replicas.mean(axis=0), 1, atol=1e-3)


@pytest.mark.parametrize("shape", [(1, 40), (40, 1), (2, 40), (40, 3)])
def test_thin_pictures_are_interpolated_along_their_length(shape):
    field, sites = polynomial(shape, 3), chosen_sites(shape, SITES)
    assert len(sites) < len(field)
    found = best_estimate(np.stack([field[sites]] * 2), sites, shape)
    np.testing.assert_allclose(found.replicas[0], field, atol=1e-9)


@pytest.mark.parametrize("shape", [(1, 1), (1, 5), (6, 4), (9, 9), (12, 200), (126, 126)])
def test_sites_are_pixels_no_more_than_asked_for_and_reach_the_edges(shape):
    sites = chosen_sites(shape, SITES)
    assert len(set(sites.tolist())) == len(sites) <= SITES**2
    rows, columns = np.divmod(sites, shape[1])
    for found, pixels in ((rows, shape[0]), (columns, shape[1])):
        assert found.min() < 0.02 * pixels and found.max() >= 0.98 * pixels - 1
        from_left, from_right = np.unique(found), np.unique(pixels - 1 - found)
        assert np.abs(from_left - from_right).max() <= 1
