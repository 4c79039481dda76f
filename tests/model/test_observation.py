from functools import partial

import numpy as np
import pytest

from periscopy_sim.model.observation import observation_of
from periscopy_sim.reconstruction.baselines.differencing import Differencing
from periscopy_sim.reconstruction.baselines.truncated_svd import TruncatedSVD
from periscopy_sim.reconstruction.large_scale.iterative import IterativePeriscope
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
    "periscope": partial(Periscope, hidden_shape=HIDDEN, channel_gain=GAIN),
    "factored": partial(Periscope, hidden_shape=HIDDEN, channel_gain=GAIN, explicit=False),
    "iterative": partial(IterativePeriscope, hidden_shape=HIDDEN, channel_gain=GAIN),
    "noise-aware": partial(
        NoiseAware, hidden_shape=HIDDEN, channel_gain=GAIN, profiles=False, corrections=()
    ),
    "svd": lambda A, _=None, **more: TruncatedSVD(
        A, **{"hidden_shape": HIDDEN, "channel_gain": GAIN} | more
    ),
}
"""Methods that need not know which pixels are neighbours."""
ALL = FITTED | {
    "differencing": lambda A, _=None, **more: Differencing(
        A, photograph_shape=PHOTOGRAPH, hidden_shape=HIDDEN, channel_gain=GAIN, **more
    )
}


def spoilt(photograph=Y):
    """Garbage where the mask leaves the photograph out."""
    garbage = np.resize([1e30, np.nan, -np.inf, np.inf, -1e300, 0.0, 7.0], photograph.shape)
    return np.where(MASK[..., None], photograph, garbage)


@pytest.mark.parametrize("method", FITTED)
def test_masked_method_is_the_one_fitted_to_the_rows_used(method):
    masked = FITTED[method](A, B, mask=MASK)
    by_hand = FITTED[method](A[USED], B[USED])
    expected = by_hand.reconstruct(Y.reshape(M, 3)[USED])
    image = masked.reconstruct(Y)
    assert image.shape == (*HIDDEN, 3)
    np.testing.assert_allclose(image, expected, rtol=1e-5, atol=1e-6)
    assert np.abs(image - FITTED[method](A, B).reconstruct(Y)).max() > 1e-4  # and not of the whole


def test_estimate_is_the_dense_pseudoinverse_of_the_rows_used():
    plain = {"tv_weight": 0, "repair_threshold": np.inf, "explicit": False}
    image = Periscope(A, B, hidden_shape=HIDDEN, mask=MASK, **plain).reconstruct(spoilt())
    P = np.linalg.pinv(np.hstack([A, B])[USED])[:N]
    np.testing.assert_allclose(image.reshape(N, 3), P @ Y.reshape(M, 3)[USED], rtol=1e-8)


@pytest.mark.parametrize("method", ALL)
def test_whatever_lies_under_the_mask_changes_nothing(method):
    fitted = ALL[method](A, B, mask=MASK)
    expected = fitted.reconstruct(Y)
    assert np.isfinite(expected).all()
    np.testing.assert_array_equal(fitted.reconstruct(spoilt()), expected)
    rows = np.where(USED[:, None], A, np.nan), np.where(USED[:, None], B, np.inf)
    again = ALL[method](*rows, mask=MASK)
    np.testing.assert_array_equal(again.reconstruct(spoilt()), expected)


@pytest.mark.parametrize("method", ALL)
def test_what_is_used_must_be_finite(method):
    y = Y.copy()
    y[tuple(np.argwhere(MASK)[7])] = np.nan
    with pytest.raises(ValueError, match="must be finite"):
        ALL[method](A, B, mask=MASK).reconstruct(y)


UNFIT = {
    "every pixel": np.zeros(PHOTOGRAPH, bool),
    "11 pixels for 12 patches": np.arange(M) < 11,
    r"shape \(13, 9\)": np.ones((13, 9), bool),
    r"shape \(9, 14\)": np.ones((9, 14), bool),
    r"shape \(14, 9, 3\)": np.ones((*PHOTOGRAPH, 3), bool),
    "boolean": np.ones(PHOTOGRAPH),
}


@pytest.mark.parametrize("message", UNFIT)
def test_mask_that_does_not_fit_is_rejected(message):
    with pytest.raises(ValueError, match=message):
        observation_of(A, HIDDEN, mask=UNFIT[message], photograph_shape=PHOTOGRAPH)


@pytest.mark.parametrize("method", FITTED)
def test_photograph_of_another_size_than_the_mask_is_refused(method):
    with pytest.raises(ValueError, match=r"9x14 pixels, the .* 14x9"):
        FITTED[method](A, B, mask=MASK).reconstruct(Y.reshape(9, 14, 3))


@pytest.mark.parametrize("scale", [1e300, 1e31, 1e-31, 1e-300])
def test_photographs_whose_squares_would_overflow_or_vanish_are_refused(scale):
    kept = observation_of(np.ones((6, 2)), (1, 2))
    with pytest.raises(ValueError, match="largest value"):
        kept.planar(np.full((1, 6, 3), scale))
    with pytest.raises(ValueError, match="largest value"):
        kept.vectorized(np.full((6, 3), scale))
    assert not kept.vectorized(np.zeros((6, 3))).any()


def test_eight_bits_are_taken_as_linear_with_a_warning():
    seen = observation_of(np.ones((12, 2)), (1, 2))
    with pytest.warns(UserWarning, match="8-bit"):
        planes = seen.planar(np.full((1, 12, 3), 7, np.uint8))
    assert (planes == 7).all()
