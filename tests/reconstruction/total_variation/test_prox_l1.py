import numpy as np
import pytest

from periscopy_sim.reconstruction.total_variation.prox import (
    prox_total_variation,
    solve_total_variation,
)


def prox_l1(g, p, weight, l1_weight, **options):
    result = solve_total_variation(g, weight, previous=p, l1_weight=l1_weight, **options)
    assert result.converged
    return result.image


EXACT = {"tolerance": 1e-10, "max_iterations": 200_000}
SHAPES = [(1, 1), (1, 7), (7, 1), (4, 5), (5, 3)]


@pytest.mark.thorough
@pytest.mark.parametrize("shape", SHAPES)
@pytest.mark.parametrize(("weight", "l1_weight"), [(0.3, 0.2), (0.3, 1.5), (2.0, 0.4), (0.0, 0.7)])
def test_prox_equals_the_minimizer_by_alternating_directions(
    shape, weight, l1_weight, random_image, minimizer
):
    g, p = random_image(*shape, seed=3), random_image(*shape, seed=4)
    f = prox_l1(g, p, weight, l1_weight, **EXACT)
    np.testing.assert_allclose(f, minimizer(g, weight, 0, p, l1_weight), atol=3e-5)


@pytest.mark.parametrize("tolerance", [1e-2, 1e-4, 1e-6])
@pytest.mark.parametrize("l1_weight", [0.1, 0.8])
def test_the_objective_is_within_the_reported_gap_of_the_least(
    tolerance, l1_weight, random_image, objective, minimizer
):
    g, p = random_image(5, 6, seed=4), random_image(5, 6, seed=5)
    result = solve_total_variation(g, 0.9, previous=p, l1_weight=l1_weight, tolerance=tolerance)
    least = objective(minimizer(g, 0.9, 0, p, l1_weight), g, 0.9, 0, p, l1_weight)
    assert result.converged
    reached = objective(result.image, g, 0.9, 0, p, l1_weight)
    assert least * (1 - 1e-9) <= reached <= least / (1 - result.gap) + 1e-9


def test_without_l1_weight_it_is_the_plain_prox(blocks):
    g, p = blocks(), blocks(1)
    f = prox_l1(g, p, 0.3, 0)
    np.testing.assert_array_equal(f, prox_total_variation(g, 0.3))


@pytest.mark.parametrize("l1_weight", [0.05, 0.3, 1.2])
def test_without_total_variation_the_image_is_shrunk_towards_the_previous(l1_weight, blocks):
    g, p = blocks(), blocks(1)
    expected = p + np.sign(g - p) * np.maximum(np.abs(g - p) - l1_weight / 2, 0)
    f = prox_l1(g, p, 0, l1_weight)
    np.testing.assert_allclose(f, expected, rtol=0, atol=1e-15)


@pytest.mark.parametrize("l1_weight", [50.0, 1e6, np.inf])
def test_a_huge_l1_weight_gives_the_previous_image(l1_weight, blocks):
    g, p = blocks(), blocks(1)
    f = prox_l1(g, p, 0.3, l1_weight)
    np.testing.assert_allclose(f, p, rtol=0, atol=1e-14)


@pytest.mark.parametrize("distance", [1e2, 1e5])
def test_a_distant_previous_image_draws_each_patch_by_half_its_weight(distance, blocks):
    g = blocks().astype(np.float32)
    f = prox_l1(g, g + np.float32(distance), 0.3, 0.2, tolerance=1e-10)
    expected = prox_total_variation(g.astype(np.float64), 0.3, tolerance=1e-9) + 0.1
    np.testing.assert_allclose(f, expected, atol=2e-3)


def test_each_channel_has_its_own_weights(blocks):
    g = np.stack([blocks(seed) for seed in range(3)], axis=-1)
    p = np.stack([blocks(seed) for seed in range(3, 6)], axis=-1)
    weights, l1_weights = [0.1, 0.3, 0.0], [0.2, 0.0, 0.4]
    alone = [prox_l1(g[..., c], p[..., c], weights[c], l1_weights[c]) for c in range(3)]
    f = prox_l1(g, p, weights, l1_weights)
    np.testing.assert_array_equal(f, np.stack(alone, axis=-1))
