"""Whether a residual is white noise."""

import numpy as np
import pytest
from periscopy_sim.reconstruction.residual.structure import structure_of
from scipy import ndimage

SHAPE = (48, 60)


def draws(count, seed, shape=SHAPE):
    return np.random.default_rng(seed).standard_normal((count, *shape))


def field(scale, seed, shape=SHAPE):
    smooth = ndimage.gaussian_filter(draws(1, seed, shape)[0], scale, mode="wrap")
    return smooth / smooth.std()


def without_slow_waves(planes):
    """What a fit of the 12 slowest waves along the rows leaves."""
    _, _, columns = planes.shape
    basis = np.linalg.qr(np.cos(np.outer(np.linspace(0, np.pi, columns), np.arange(12))))[0]
    return planes - planes @ basis @ basis.T


@pytest.mark.thorough
@pytest.mark.parametrize("fit", [lambda planes: planes, without_slow_waves])
def test_white_noise_is_rarely_taken_for_structure(fit):
    # P(p < 0.05) is at most 0.05: of 200, more than 20 come about with probability 3e-3.
    sizes = np.array([1, 3, 0.2])[:, None, None]
    found = [
        structure_of(fit(sizes * draws(3, seed)), fit(draws(6, 1000 + seed))) for seed in range(200)
    ]
    assert sum(each.probability < 0.05 for each in found) <= 20
    assert not any(each.is_found for each in found)
    assert sum(each.common for each in found) <= 4  # the chance of one is 1e-3


@pytest.mark.parametrize("scale", [1.5, 3, 6])
def test_structure_in_half_the_noise_is_found_with_its_size(scale):
    residual = draws(3, 0) + 0.5 * field(scale, 1)
    found = structure_of(residual, draws(6, 2))
    assert found.is_found and found.common and found.excess > 2
    assert scale / 2 <= found.scale <= 2 * scale


def test_fit_that_hides_slow_waves_does_not_hide_structure():
    residual = without_slow_waves(draws(3, 0) + 0.5 * field(1.5, 1))
    white = without_slow_waves(draws(6, 2))
    assert structure_of(residual, white).is_found


def test_noise_that_neighbours_share_is_not_alike_in_the_channels():
    smeared = ndimage.uniform_filter(draws(3, 0), (0, 2, 2))
    found = structure_of(smeared, draws(6, 1))
    assert found.is_found and not found.common


def test_paint_of_one_pixel_is_told_by_its_likeness():
    grain = 0.9 * draws(1, 0)[0] + np.sqrt(1 - 0.81) * draws(3, 1)
    found = structure_of(grain, draws(6, 2))
    assert found.is_found and found.grain == pytest.approx(0.81, abs=0.05)
    assert found.probability > 1e-3  # it is white


def test_grey_photograph_has_one_channel_not_three():
    grey = np.repeat(draws(1, 0), 3, axis=0)
    found = [
        structure_of(np.repeat(draws(1, seed), 3, axis=0), draws(6, 1000 + seed))
        for seed in range(100)
    ]
    assert sum(each.probability < 0.05 for each in found) <= 13
    assert structure_of(grey, draws(6, 1)).likeness is None
    assert not any(each.is_found for each in found)


def test_pixels_left_out_do_not_count():
    residual, white = draws(3, 0), draws(6, 1)
    residual[:, 10:20] = white[:, 10:20] = np.nan
    assert not structure_of(residual, white).is_found
    residual[:, 30:] += field(3, 2)[30:]
    assert structure_of(residual, white).is_found


@pytest.mark.parametrize("residual", [np.zeros((3, 30, 30)), np.ones((3, 4, 4))])
def test_nothing_is_told_of_nothing(residual):
    assert structure_of(residual, draws(6, 0, residual.shape[1:])) is None
