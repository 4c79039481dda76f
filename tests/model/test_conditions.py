from functools import partial

import numpy as np
import pytest

from periscopy_sim.hidden import Hidden
from periscopy_sim.model.fit import Fit
from periscopy_sim.photograph import Photograph
from periscopy_sim.reconstruction.baselines.differencing import Differencing
from periscopy_sim.reconstruction.baselines.truncated_svd import TruncatedSVD
from periscopy_sim.reconstruction.iterative import IterativePeriscope
from periscopy_sim.reconstruction.noise_aware.noise_aware import NoiseAware
from periscopy_sim.reconstruction.preconditioned.still import Periscope

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
USED = MASK.ravel()

FITTED = {
    "periscope": partial(Periscope, hidden=HIDDEN, channel_gain=GAIN),
    "factored": partial(Periscope, hidden=HIDDEN, channel_gain=GAIN, explicit=False),
    "iterative": partial(IterativePeriscope, hidden=HIDDEN, channel_gain=GAIN),
    "noise-aware": partial(
        NoiseAware, hidden=HIDDEN, channel_gain=GAIN, profiles=False, corrections=()
    ),
    "svd": lambda A, _=None, **more: TruncatedSVD(
        A, **{"hidden": HIDDEN, "channel_gain": GAIN} | more
    ),
}
"""Methods that need not know which pixels are neighbours."""
ALL = FITTED | {
    "differencing": lambda A, _=None, **more: Differencing(
        A, photograph_shape=PHOTOGRAPH, hidden=HIDDEN, **{"channel_gain": GAIN} | more
    )
}


MASKED = Photograph.of(Y, mask=MASK)


def spoilt():
    """Garbage where the mask leaves the photograph out."""
    garbage = np.resize([1e30, np.nan, -np.inf, np.inf, -1e300, 0.0, 7.0], Y.shape)
    return Photograph.of(np.where(MASK[..., None], Y, garbage), mask=MASK)


def test_estimate_is_the_dense_pseudoinverse_of_the_rows_used():
    plain = {"tv_weight": 0, "repair_threshold": np.inf, "explicit": False}
    image = Periscope(A, B, hidden=HIDDEN, **plain).reconstruct(spoilt())
    P = np.linalg.pinv(np.hstack([A, B])[USED])[:N]
    np.testing.assert_allclose(image.reshape(N, 3), P @ Y.reshape(M, 3)[USED], rtol=1e-8)


def fitted(photograph):
    return Fit(A, B, hidden=Hidden.of(HIDDEN), photograph_shape=PHOTOGRAPH, conditions=photograph)


def test_mask_that_leaves_fewer_pixels_than_patches_is_rejected():
    few = Photograph.of(Y, mask=np.arange(M).reshape(PHOTOGRAPH) < 11)
    with pytest.raises(ValueError, match="11 pixels for 12 patches"):
        fitted(few)
    with pytest.raises(ValueError, match="11 pixels for 12 patches"):
        NoiseAware(A, B, hidden=HIDDEN).fitted_to(few)


@pytest.mark.parametrize("method", FITTED)
def test_photograph_of_another_size_than_the_mask_is_refused(method):
    with pytest.raises(ValueError, match=r"9x14 pixels, the .* 14x9"):
        FITTED[method](A, B).fitted_to(MASKED).reconstruct(Y.reshape(9, 14, 3))
    turned = Photograph.of(Y.reshape(9, 14, 3), mask=MASK.reshape(9, 14))
    with pytest.raises(ValueError, match=r"9x14 pixels, the .* 14x9"):
        FITTED[method](A, B, photograph_shape=PHOTOGRAPH).reconstruct(turned)


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
    np.testing.assert_array_equal(fit.gain(1), [1])
    np.testing.assert_array_equal(fit.gain(3), GAIN)
    with pytest.raises(ValueError, match="4 channels, the wall's colour 3"):
        fit.planes(np.ones((1, M, 4)))
    assert (Fit(A, hidden=Hidden.of(HIDDEN), channel_gain=np.ones(3)).gain(4) == np.ones(4)).all()


@pytest.mark.parametrize("method", ALL)
@pytest.mark.parametrize("channels", [1, 2, 4])
def test_an_image_has_the_channels_of_the_photograph(method, channels):
    grey = {"channel_gain": None}
    y = A @ TRUTH[:, [1, 0, 2, 1]] + B @ np.ones((3, 4)) + 1e-3 * RNG.normal(size=(M, 4))
    many = y[:, :channels].reshape(*PHOTOGRAPH, channels)
    fitted = ALL[method](A, B, **grey)
    image = fitted.reconstruct(Photograph.of(many))
    assert image.shape == (*HIDDEN, channels)
    if channels == 1:  # also on a coloured wall, and as two channels alike
        np.testing.assert_array_equal(ALL[method](A, B).reconstruct(many[..., 0:1]), image)
        twice = fitted.reconstruct(np.repeat(many, 2, axis=2))
        np.testing.assert_allclose(twice, np.repeat(image, 2, axis=2), rtol=1e-2, atol=1e-2)
