import numpy as np
import pytest

from periscopy_sim.model.noise import camera_noise, residual_noise, second_differences

SIZES = np.array([1.0, 2.0, 0.5])[:, None, None]
V, U = np.meshgrid(*(np.linspace(-1, 1, 63),) * 2, indexing="ij")
PENUMBRAE = 100 * (1 / (1 + np.exp(-12 * U)) + 0.3 * V**2 + 0.2 * np.sin(3 * V * U))


def noise(shape, seed):
    return SIZES * np.random.default_rng(seed).standard_normal((3, *shape))


def test_differences_remove_linear_light_and_keep_the_variance_of_noise():
    assert np.abs(second_differences(np.stack([U, 3 * V + 1, U * V]))).max() < 1e-12
    found = np.mean(second_differences(noise(V.shape, 0)) ** 2, axis=(1, 2))
    np.testing.assert_allclose(found, SIZES.ravel() ** 2, rtol=0.15)
    y = noise(V.shape, 0)
    y[:, 30, 30] = np.nan
    assert np.isnan(second_differences(y)).sum(axis=(1, 2)).tolist() == [9, 9, 9]


@pytest.mark.parametrize("shape", [(24, 24), (40, 61)])
def test_estimate_is_unbiased(shape):
    found = np.array([camera_noise(noise(shape, seed)) for seed in range(120)]) / SIZES.ravel()
    # Five standard errors of the mean, and what so few differences cost.
    error = found.std(axis=0) / np.sqrt(120)
    assert (np.abs(found.mean(axis=0) - 1) < 5 * error + 0.01).all()
    assert found.std() < 2 / np.sqrt(np.prod(shape))


def test_light_of_the_scene_is_no_noise():
    found = camera_noise(noise(V.shape, 0) + PENUMBRAE)
    assert np.abs(found / SIZES.ravel() - 1).max() < 0.12


def test_edge_of_a_poster_and_dead_lines_are_no_noise():
    y = noise(V.shape, 1)
    y[:, 20:40, 10:30] += 50
    y[:, :, 50] = -30
    assert np.abs(camera_noise(y) / SIZES.ravel() - 1).max() < 0.15


def test_more_explained_than_there_is_does_not_pass_silently():
    energy = np.ones(3)
    assert residual_noise(energy, energy + 1e-7, 10).max() < 1e-6
    with pytest.warns(UserWarning, match="rounding explains more"):
        residual_noise(energy, energy + 1e-5 * np.eye(3)[0], 10)
