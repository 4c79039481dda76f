"""White noise has a flat spectrum, errors alike over an area are strong at low frequencies."""

import numpy as np
import pytest
from periscopy_sim.calibration.explanation.discrepancy import Whitening, WhiteNoise
from periscopy_sim.calibration.explanation.evidence import explain
from scipy import fft
from scipy.ndimage import gaussian_filter

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


def strongest(errors_of, seeds, used=USED):
    return np.array([spectrum_of(errors_of(np.random.default_rng(s)), s, used) for s in seeds])


def discrepancy(found, used, seed, *left_of):
    return WhiteNoise.by(found, used, seed, *left_of).discrepancy(found)


def spectrum_of(errors, seed, used=USED):
    return Whitening(used, discrepancy(explained(errors, used), used, seed)).discrepancy


def white(random):
    return random.standard_normal((*SHAPE, 3))


@pytest.mark.parametrize("masked", [False, True])
def test_white_noise_has_no_discrepancy(masked):
    used = USED.copy()
    used[:10, 5:25] = not masked
    found = strongest(white, range(8), used)
    assert found.mean() < 1.5 and found.max() < 2


def test_errors_alike_over_an_area_count_as_its_pixels():
    # Blurred by a Gaussian of width s, white noise is as strong at low frequencies as before, its
    # variance 4 π s² times less. Averaged over bands it is somewhat less: 16 ± 2 of 28 with 100
    # other seeds.
    width = 1.5

    def blurred(random):
        return gaussian_filter(random.standard_normal((*SHAPE, 3)), (width, width, 0), mode="wrap")

    found = strongest(blurred, range(8))
    area = 4 * np.pi * width**2
    assert 0.4 * area < found.mean() < area


def test_a_seam_is_seen_in_its_own_direction():
    # Mean of 20 other seeds 1.8, where all directions in one band would give 1.2.
    step = np.where(np.arange(SHAPE[1]) > 17, 0.5, -0.5)[:, None] * np.ones((*SHAPE, 1))
    assert strongest(lambda random: step + white(random), range(8)).mean() > 1.4


@pytest.mark.parametrize("masked", [False, True])
def test_it_filters_as_cosines_say_and_is_its_own_adjoint(masked):
    random = np.random.default_rng(0)
    used = random.random(SHAPE) > 0.3 * masked
    spectrum = np.exp(random.standard_normal(SHAPE))
    filtered, count = Whitening(used, spectrum), int(used.sum())
    one, other = random.standard_normal((2, count, 3))
    laid = np.zeros((*SHAPE, 3))
    laid[used] = one
    spectrum = spectrum / np.exp(np.log(spectrum).mean())  # the determinant is 1
    cosines = fft.dctn(laid, axes=(0, 1), norm="ortho") / np.sqrt(spectrum)[..., None]
    np.testing.assert_allclose(
        filtered(one), fft.idctn(cosines, axes=(0, 1), norm="ortho")[used], atol=1e-12
    )
    assert np.vdot(filtered(one), other) == pytest.approx(np.vdot(one, filtered(other)))


def test_it_makes_blurred_errors_white():
    random = np.random.default_rng(1)
    errors = gaussian_filter(random.standard_normal((*SHAPE, 3)), (1.5, 1.5, 0))
    spectrum = discrepancy(explained(errors), USED, 0)
    whitened = Whitening(USED, spectrum)(errors[USED]).reshape(*SHAPE, 3)
    assert spectrum_of(errors, 0) > 10 > 3 > spectrum_of(whitened, 0)


def test_what_parameters_would_explain_is_no_discrepancy():
    """A step that one of them makes, ten times the noise; of what it leaves white noise is left."""
    step = np.where(np.arange(SHAPE[1]) > 17, 10.0, -10.0)[:, None] * np.ones((*SHAPE, 1))
    found = explained(step * [1, 1, 1] + white(np.random.default_rng(0)))
    direction = found.left_of((step * [1.0, 1, 1])[USED])
    direction /= np.linalg.norm(direction)

    def left_of(errors):
        return errors - np.vdot(direction, errors) * direction

    assert Whitening(USED, discrepancy(found, USED, 0)).discrepancy > 20
    assert Whitening(USED, discrepancy(found, USED, 0, left_of)).discrepancy < 2
