"""White noise from differences of neighbouring pixels."""

import numpy as np
import pytest

from periscopy_sim.model.noise import camera_noise

SIZES = np.array([1.0, 2.0, 0.5])[:, None, None]
V, U = np.meshgrid(*(np.linspace(-1, 1, 63),) * 2, indexing="ij")
PENUMBRAE = 100 * (1 / (1 + np.exp(-12 * U)) + 0.3 * V**2 + 0.2 * np.sin(3 * V * U))


def noise(shape, seed):
    return SIZES * np.random.default_rng(seed).standard_normal((3, *shape))


@pytest.mark.parametrize("shape", [(24, 24), (40, 61), (63, 63)])
def test_estimate_lies_about_the_noise_as_far_as_it_tells(shape):
    # 120 draws of 3 channels: the spread of their z is known to 4 %, their mean to 0.05.
    found = [camera_noise(noise(shape, seed)) for seed in range(120)]
    z = np.array([(each.σ - SIZES.ravel()) / each.standard_error for each in found])
    assert 0.84 < z.std() < 1.16
    assert abs(z.mean()) < 0.3  # what trimming costs small tiles


def test_light_of_the_scene_is_no_noise():
    found = camera_noise(noise(V.shape, 0) + PENUMBRAE)
    assert np.abs(found.σ / SIZES.ravel() - 1).max() < 0.12


def test_edge_of_a_poster_and_dead_lines_are_no_noise():
    y = noise(V.shape, 1)
    y[:, 20:40, 10:30] += 50
    y[:, :, 50] = -30
    assert np.abs(camera_noise(y).σ / SIZES.ravel() - 1).max() < 0.15


def test_pixels_left_out_do_not_count():
    y = noise(V.shape, 2)
    mask = V > 0.3
    y[:, mask] = np.nan
    kept = camera_noise(y)
    y[:, mask] = 1e6
    y[:, mask] += 1e5 * np.random.default_rng(0).standard_normal((3, mask.sum()))
    assert np.abs(kept.σ / SIZES.ravel() - 1).max() < 0.12
    assert (camera_noise(y).standard_error < kept.standard_error * 1e6).all()


def test_noise_that_follows_the_light_is_its_mean_energy():
    brightness = 1 + 0.8 * V
    found = camera_noise(noise(V.shape, 3) * brightness)
    expected = SIZES.ravel() * np.sqrt(np.mean(brightness**2))
    assert np.abs(found.σ / expected - 1).max() < 0.1


@pytest.mark.parametrize("shape", [(2, 50), (1, 1), (6, 6)])
def test_too_few_pixels_tell_nothing(shape):
    assert camera_noise(np.ones((3, *shape))) is None
