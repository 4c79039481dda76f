"""How much stronger than white noise a residual is where it is strongest."""

import numpy as np
import pytest
from periscopy_sim.model.overdispersion import overdispersion_of
from scipy import ndimage

SHAPE = (32, 40)
USED = np.ones(SHAPE, bool)
USED[10:14, 5:20] = False


def overdispersion(residuals, leave=lambda errors: errors):
    return overdispersion_of(residuals[USED], leave, USED)


def white(seed):
    return np.random.default_rng(seed).standard_normal((*SHAPE, 3))


def test_white_noise_is_about_one():
    found = [overdispersion(white(seed)) for seed in range(1, 40)]
    assert min(found) >= 1 and np.mean(found) < 1.25


def test_errors_that_channels_share_count_threefold():
    shared = [overdispersion(np.repeat(white(seed)[..., :1], 3, axis=2)) for seed in range(1, 20)]
    assert np.mean(shared) == pytest.approx(3, rel=0.2)


@pytest.mark.parametrize("scale", [3, 10])
def test_scale_of_the_residual_squares(scale):
    once = overdispersion(5 * white(1))
    assert overdispersion(5 * scale * white(1)) == pytest.approx(scale**2 * once)


def test_smooth_errors_and_seams_stand_out_of_noise():
    noise = white(1)
    smooth = ndimage.gaussian_filter(white(2), (3, 3, 0))
    seam = np.zeros((*SHAPE, 3))
    seam[:, 21] = 3
    assert overdispersion(noise + 2 * smooth / smooth.std()) > 10
    assert overdispersion(noise + seam) > 3


def test_residual_is_compared_with_noise_that_lost_as_much():
    Q = np.linalg.qr(np.random.default_rng(3).standard_normal((USED.sum(), USED.sum() // 2)))[0]

    def leave(errors):
        return errors - Q @ (Q.T @ errors)

    left = np.zeros((*SHAPE, 3))
    left[USED] = leave(white(1)[USED])
    assert overdispersion(left, leave) < 1.5 < 1.9 < overdispersion(2 * white(1), leave)
    assert overdispersion(100 * white(1), lambda errors: 0 * errors) == 1
