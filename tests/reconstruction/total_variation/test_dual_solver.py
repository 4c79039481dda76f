import numpy as np
import pytest

from periscopy_sim.reconstruction.total_variation.prox import prox_total_variation


def test_a_result_short_of_the_tolerance_is_flagged(blocks, solved):
    g = blocks()
    result = solved(g, 0.5, max_iterations=3)
    assert result.iterations == 3
    assert result.gap > 1e-4
    with pytest.warns(RuntimeWarning, match="after 3 iterations"):
        prox_total_variation(g, 0.5, max_iterations=3)


@pytest.mark.parametrize("weight", [7.0, 10.0])
def test_restarts_keep_strong_weights_cheap(weight, random_image, solved):
    # Without restarts these take 750 and 830 iterations.
    assert solved(random_image(29, 36), weight).iterations < 450


@pytest.mark.parametrize("temporal_weight", [0.0, 1.0])
def test_starting_from_a_similar_problems_dual_takes_fewer_iterations(temporal_weight, solved):
    rng = np.random.default_rng(5)
    scene = np.kron(rng.random((2, 5, 4, 3)), np.ones((1, 6, 6, 1)))
    images = scene + 0.3 * rng.standard_normal(scene.shape)
    settings = {"w": temporal_weight, "tolerance": 1e-5}
    first = solved(images, 1.0, **settings)
    changed = images + 0.02 * rng.standard_normal(scene.shape)
    cold = solved(changed, 1.1, **settings)
    warm = solved(changed, 1.1, start=first.dual, **settings)
    assert warm.gap <= 1e-5
    assert warm.iterations < 0.8 * cold.iterations
    np.testing.assert_allclose(warm.image, cold.image, atol=2e-2)
    again = solved(images, 1.0, start=first.dual, **settings)
    assert again.iterations <= 10  # until the gap is looked at first
    lengths = np.sqrt(np.sum(warm.dual.astype(np.float64) ** 2, axis=1))
    assert lengths.max() <= 1 + 1e-6
