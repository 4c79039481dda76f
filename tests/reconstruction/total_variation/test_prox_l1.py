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
