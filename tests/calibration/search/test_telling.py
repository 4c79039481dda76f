from types import SimpleNamespace

import numpy as np
import pytest

from periscopy_sim.calibration.search.image_shift import BETWEEN_PATCHES, NEGLIGIBLE
from periscopy_sim.calibration.search.telling import CERTAIN, standard_error, worth

ROWS, COLUMNS = 40, 60
LEVEL = SimpleNamespace(photograph_shape=(ROWS, COLUMNS), used=np.ones((ROWS, COLUMNS), bool))


def seen(residuals, deviations=(1.0, 1.0, 1.0)):
    return SimpleNamespace(residuals=residuals, deviations=np.array(deviations))


def test_the_standard_error_is_the_spread_of_the_difference_over_draws_of_white_noise():
    """Twice the length of what two models differ by, over the noise: both are wrong alike."""
    rng = np.random.default_rng(1)
    differ = 0.05 * rng.normal(size=(ROWS * COLUMNS, 3))
    differences, told = [], []
    for _ in range(300):
        noise = rng.normal(size=differ.shape)
        here, there = noise + differ, noise - differ
        differences.append(np.sum(here**2) - np.sum(there**2))
        told.append(standard_error(LEVEL, seen(here), seen(there)))
    assert np.std(differences) == pytest.approx(4 * np.linalg.norm(differ), rel=0.15)  # 4 errors
    assert np.mean(told) == pytest.approx(np.std(differences), rel=0.15)


def test_errors_that_neighbours_share_are_told():
    """In squares of 4 x 6 pixels; by pixels that are independent one would think them a third."""
    rng = np.random.default_rng(2)
    differ = np.kron(0.05 * rng.normal(size=(10, 10)), np.ones((4, 6))).ravel()[:, None]
    differences, told = [], []
    for _ in range(300):
        shared = np.kron(rng.normal(size=(10, 10)), np.ones((4, 6))).ravel()[:, None]
        here, there = (shared + sign * differ for sign in (1, -1))
        differences.append(np.sum(here**2) - np.sum(there**2))
        told.append(standard_error(LEVEL, seen(here, (1.0,)), seen(there, (1.0,))))
    assert np.mean(told) == pytest.approx(np.std(differences), rel=0.15)
    assert np.std(differences) > 3 * 4 * np.linalg.norm(differ)


def test_each_place_has_a_noise_of_its_own_and_pixels_that_are_masked_do_not_count():
    rng = np.random.default_rng(3)
    noise, other = rng.normal(size=(2, ROWS * COLUMNS, 3))
    whole = standard_error(LEVEL, seen(noise), seen(other))
    doubled = standard_error(LEVEL, seen(2 * noise, (2, 2, 2)), seen(other))
    assert doubled == pytest.approx(whole)
    used = np.ones((ROWS, COLUMNS), bool)
    used[:, : COLUMNS // 2] = False
    half = SimpleNamespace(photograph_shape=(ROWS, COLUMNS), used=used)
    left = (seen(values[used.ravel()]) for values in (noise, other))
    assert standard_error(half, *left) == pytest.approx(whole / np.sqrt(2), rel=0.25)


def test_what_is_certain_is_worth_a_move_and_what_the_rays_change_is_not():
    calm = seen(np.zeros((ROWS * COLUMNS, 3)))
    assert worth(LEVEL, calm, calm) == BETWEEN_PATCHES * NEGLIGIBLE
    rng = np.random.default_rng(4)
    here, there = (seen(each) for each in rng.normal(size=(2, ROWS * COLUMNS, 3)))
    expected = BETWEEN_PATCHES * CERTAIN * standard_error(LEVEL, here, there)
    assert worth(LEVEL, here, there) == expected > BETWEEN_PATCHES * NEGLIGIBLE
