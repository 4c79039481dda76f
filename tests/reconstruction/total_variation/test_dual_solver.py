"""Precision, layouts, convergence and starts of the denoising, seen through its callers."""

import numpy as np
import pytest

from periscopy_sim.reconstruction.total_variation.prox import (
    prox_total_variation,
    solve_total_variation,
)


def objective(f, g, weight):
    down, across = np.diff(f, axis=0, append=f[-1:]), np.diff(f, axis=1, append=f[:, -1:])
    return ((f - g) ** 2).sum() + weight * np.hypot(down, across).sum()


@pytest.mark.parametrize("weight", [0.01, 0.1, 0.5, 2.0, 7.0, 20.0])
@pytest.mark.parametrize("tolerance", [1e-3, 1e-4, 1e-5])
def test_single_precision_agrees_with_double_precision_up_to_their_gaps(
    weight, tolerance, blocks, random_image
):
    g = np.kron(blocks(), np.ones((2, 2))) + 0.2 * random_image(24, 30)
    single = solve_total_variation(g.astype(np.float32), weight, tolerance=tolerance)
    double = solve_total_variation(g, weight, tolerance=tolerance)
    assert single.converged
    allowed = np.sqrt(objective(double.image, g, weight))
    allowed *= np.sqrt(single.gap) + np.sqrt(double.gap)
    assert np.linalg.norm(single.image - double.image) <= allowed + 1e-6 * np.linalg.norm(g)
    # The reported gap is the image's own, whose objective is that much above the least at most.
    reached = objective(single.image.astype(np.float64), g, weight)
    assert reached <= objective(double.image, g, weight) / (1 - single.gap) * (1 + 2e-6)


def test_a_tolerance_beyond_single_precision_is_met_in_double_precision(blocks):
    g = blocks().astype(np.float32)
    expected = prox_total_variation(g.astype(np.float64), 0.3, tolerance=1e-11)
    f = prox_total_variation(g, 0.3, tolerance=1e-11)
    np.testing.assert_allclose(f, expected, rtol=1e-6)


def test_result_reports_the_slowest_channel(blocks):
    g = np.stack([blocks(), blocks(1)], axis=-1)
    alone = [solve_total_variation(g[..., c], λ) for c, λ in enumerate((0.05, 1.5))]
    both = solve_total_variation(g, [0.05, 1.5])
    assert both.iterations == max(result.iterations for result in alone)
    assert both.gap == max(result.gap for result in alone)


def test_a_result_short_of_the_tolerance_is_flagged(blocks):
    g = blocks()
    result = solve_total_variation(g, 0.5, max_iterations=3)
    assert not result.converged
    assert result.iterations == 3
    assert result.gap > 1e-4
    with pytest.warns(RuntimeWarning, match="after 3 iterations"):
        prox_total_variation(g, 0.5, max_iterations=3)


@pytest.mark.parametrize("weight", [7.0, 10.0])
def test_restarts_keep_strong_weights_cheap(weight, random_image):
    # Without restarts these take 750 and 830 iterations.
    assert solve_total_variation(random_image(29, 36), weight).iterations < 450


@pytest.mark.parametrize("dtype", [np.float32, np.float64])
@pytest.mark.parametrize("temporal_weight", [None, 1.0])
def test_starting_from_a_similar_problems_dual_takes_fewer_iterations(dtype, temporal_weight):
    rng = np.random.default_rng(5)
    scene = np.kron(rng.random((2, 5, 4, 3)), np.ones((1, 6, 6, 1)))
    images = (scene + 0.3 * rng.standard_normal(scene.shape)).astype(dtype)
    settings = {"temporal_weight": temporal_weight, "tolerance": 1e-5}
    first = solve_total_variation(images, 1.0, **settings)
    changed = (images + 0.02 * rng.standard_normal(scene.shape)).astype(dtype)
    cold = solve_total_variation(changed, 1.1, **settings)
    warm = solve_total_variation(changed, 1.1, start=first.dual, **settings)
    assert warm.converged
    assert warm.iterations < 0.8 * cold.iterations
    assert warm.image.dtype == dtype
    np.testing.assert_allclose(warm.image, cold.image, atol=2e-2)
    again = solve_total_variation(images, 1.0, start=first.dual, **settings)
    assert again.iterations <= 10  # until the gap is looked at first
    lengths = np.sqrt(np.sum(warm.dual.astype(np.float64) ** 2, axis=1))
    assert lengths.max() <= 1 + 1e-6
