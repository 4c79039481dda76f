import numpy as np
import pytest

from periscopy_sim.hidden import Hidden
from periscopy_sim.model.fit import Fit
from periscopy_sim.photograph import Photograph
from periscopy_sim.reconstruction.noise_aware import NoiseAware

PHOTOGRAPH, HIDDEN = (14, 9), (3, 4)
M, N = 126, 12
RNG = np.random.default_rng(40)
A = RNG.uniform(0.1, 1, (M, N))
B = RNG.uniform(0.1, 1, (M, 3))
GAIN = np.array([1.2, 1.0, 0.8])
TRUTH = RNG.uniform(0.1, 1, (N, 3))
SIGNAL = (A @ TRUTH + B @ RNG.uniform(0, 2, (3, 3))) * GAIN
Y = (SIGNAL + 1e-3 * RNG.normal(size=(M, 3))).reshape(*PHOTOGRAPH, 3)
MASK = RNG.random(PHOTOGRAPH) > 0.25
MASK[5:8, 2:6] = False

MASKED = Photograph.of(Y, mask=MASK)


def fitted(photograph):
    return Fit(A, B, hidden=Hidden.of(HIDDEN), photograph_shape=PHOTOGRAPH, conditions=photograph)


def test_mask_that_leaves_fewer_pixels_than_patches_is_rejected():
    few = Photograph.of(Y, mask=np.arange(M).reshape(PHOTOGRAPH) < 11)
    with pytest.raises(ValueError, match="11 pixels for 12 patches"):
        fitted(few)
    with pytest.raises(ValueError, match="11 pixels for 12 patches"):
        NoiseAware(A, B, hidden=HIDDEN).fitted_to(few)


def test_photograph_of_another_size_than_the_mask_is_refused():
    with pytest.raises(ValueError, match=r"9 x 14 pixels .* 14 x 9"):
        fitted(MASKED).planes(Y.reshape(1, 9, 14, 3))
    with pytest.raises(ValueError, match=r"9 x 14 pixels .* 14 x 9"):
        fitted(Photograph.of(Y.reshape(9, 14, 3), mask=MASK.reshape(9, 14)))


@pytest.mark.parametrize("scale", [1e300, 1e31, 1e-31, 1e-300])
def test_photographs_whose_squares_would_overflow_or_vanish_are_refused(scale):
    kept = Fit(np.ones((6, 2)), hidden=Hidden.of((1, 2)))
    with pytest.raises(ValueError, match="largest value"):
        kept.planes(np.full((1, 6, 3), scale))
    with pytest.raises(ValueError, match="largest value"):
        kept.vectors(np.full((6, 3), scale))
    assert not kept.vectors(np.zeros((6, 3))).any()


def test_eight_bits_are_taken_as_linear_with_a_warning():
    seen = Fit(np.ones((12, 2)), hidden=Hidden.of((1, 2)))
    with pytest.warns(UserWarning, match="8-bit"):
        planes = seen.planes(np.full((1, 12, 3), 7, np.uint8))
    assert (planes == 7).all()


def test_grey_photographs_show_no_colour_of_the_wall_and_others_need_one_for_each_channel():
    fit = Fit(A, hidden=Hidden.of(HIDDEN), channel_gain=GAIN)
    np.testing.assert_array_equal(fit.gain(1), [[1]])
    np.testing.assert_array_equal(fit.gain(3), [GAIN])
    with pytest.raises(ValueError, match="4 channels, the wall's colour 3"):
        fit.planes(np.random.default_rng(0).random((1, M, 4)))
    assert (Fit(A, hidden=Hidden.of(HIDDEN), channel_gain=np.ones(3)).gain(4) == 1).all()
