import numpy as np
import pytest

from periscopy_sim.reconstruction.total_variation.prox import (
    prox_total_variation,
)

EXACT = {"tolerance": 1e-10, "max_iterations": 200_000}


@pytest.fixture
def moving_blocks(random_image):
    video = np.zeros((2, 12, 15))
    video[0, 2:7, 3:11] = 1.0
    video[1, 3:8, 4:12] = 1.0
    return video + 0.2 * random_image(2, 12, 15)


@pytest.mark.parametrize("coloured", [False, True])
def test_without_temporal_weight_each_frame_is_denoised_on_its_own(coloured, moving_blocks):
    g = moving_blocks
    weight = 0.4
    if coloured:
        g, weight = np.stack([g, -3 * g], axis=-1), [0.4, 0.1]
    f = prox_total_variation(g, weight, temporal_weight=0)
    alone = [prox_total_variation(frame, weight) for frame in g]
    np.testing.assert_array_equal(f, np.stack(alone))


@pytest.mark.parametrize(
    ("weight", "w", "expected"),
    [
        (2.0, 0.2, [0.2, 0.8]),
        (4.5, 0.2, [0.45, 0.55]),
        (5.5, 0.2, [0.5, 0.5]),
        (0.3, 2, [0.3, 0.7]),
    ],
)
def test_a_change_in_time_shrinks_by_the_weight_of_time(weight, w, expected):
    g = np.zeros((2, 3, 4))
    g[1] = 1.0
    f = prox_total_variation(g, weight, temporal_weight=w, **EXACT)
    np.testing.assert_allclose(f[:, 1, 2], expected, atol=1e-6)
    np.testing.assert_allclose(np.ptp(f, axis=(1, 2)), 0, atol=1e-6)


def test_frames_that_time_ties_firmly_become_the_denoised_mean(random_image):
    g = random_image(2, 4, 5)
    f = prox_total_variation(g, 1.0, temporal_weight=15, tolerance=1e-6, max_iterations=50_000)
    mean = prox_total_variation(g.mean(axis=0), 1.0, **EXACT)
    np.testing.assert_allclose(f, np.stack([mean, mean]), atol=5e-3)
