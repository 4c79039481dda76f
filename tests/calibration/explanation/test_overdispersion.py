"""White noise has an overdispersion of about 1, errors alike over an area that area in pixels."""

import numpy as np
import pytest
from scipy.ndimage import gaussian_filter

from periscopy_sim.calibration.explanation.evidence import explain
from periscopy_sim.calibration.explanation.overdispersion import overdispersion

SHAPE, HIDDEN = (32, 40), (3, 4)
USED = np.ones(SHAPE, bool)


def explained(errors, used=USED):
    """Explain a wall of twelve broad lights and a gradient, but for errors, (rows, columns, 3)."""
    down, across = (np.linspace(-1, 1, size) for size in SHAPE)
    places = np.stack(np.meshgrid(np.linspace(-1, 1, 3), np.linspace(-1, 1, 4)), -1).reshape(-1, 2)
    lights = [np.exp(-np.add.outer((down - v) ** 2, (across - u) ** 2)) for v, u in places]
    A = np.stack([light[used] for light in lights], axis=1)
    Q = np.linalg.qr(np.stack([np.ones(len(A)), np.add.outer(down, 0 * across)[used]], axis=1))[0]
    image = 1 + np.random.default_rng(7).random((12, 3))
    return explain(A, Q, A @ image + 0.01 * errors[used], HIDDEN)


def overdispersions(errors_of, seeds, used=USED):
    return np.array(
        [
            overdispersion(explained(errors_of(np.random.default_rng(s)), used), used, s)
            for s in seeds
        ]
    )


def white(random):
    return random.standard_normal((*SHAPE, 3))


@pytest.mark.parametrize("masked", [False, True])
def test_white_noise_has_an_overdispersion_of_about_one(masked):
    # Over 200 other seeds: mean 1.04, standard deviation 0.07, largest 1.4.
    used = USED.copy()
    used[:10, 5:25] = not masked
    found = overdispersions(white, range(8), used)
    assert (found >= 1).all()
    assert found.mean() < 1.15 and found.max() < 1.6


def test_white_noise_that_the_channels_share_counts_nearly_threefold():
    # Mean of 100 other seeds 2.55, standard deviation 0.22: what chance alone makes is divided out.
    found = overdispersions(
        lambda r: np.repeat(r.standard_normal((*SHAPE, 1)), 3, axis=2), range(8)
    )
    assert 2.2 < found.mean() < 3


def test_errors_alike_over_an_area_count_as_its_pixels():
    # Blurred by a Gaussian of width s, white noise is as strong at low frequencies as before, its
    # variance 4 π s² times less. Averaged over bands it is somewhat less: 16 ± 2 of 28 with 100
    # other seeds.
    width = 1.5

    def blurred(random):
        return gaussian_filter(random.standard_normal((*SHAPE, 3)), (width, width, 0), mode="wrap")

    found = overdispersions(blurred, range(8))
    area = 4 * np.pi * width**2
    assert 0.4 * area < found.mean() < area


def test_a_seam_is_seen_in_its_own_direction():
    # Mean of 20 other seeds 1.8, where all directions in one band would give 1.2.
    step = np.where(np.arange(SHAPE[1]) > 17, 0.5, -0.5)[:, None] * np.ones((*SHAPE, 1))
    assert overdispersions(lambda random: step + white(random), range(8)).mean() > 1.4


def test_where_image_and_light_absorb_all_nothing_is_said():
    used = np.zeros(SHAPE, bool)
    used[10:13, 10:14] = True
    assert overdispersion(explained(white(np.random.default_rng(0)), used), used, 0) == 1
