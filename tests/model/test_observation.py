import numpy as np
import pytest

from periscopy_sim.model.observation import observation_of

PHOTOGRAPH, HIDDEN = (14, 9), (3, 4)
M, N = 126, 12
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
        observation_of(np.ones((M, N)), HIDDEN, mask=UNFIT[message], photograph_shape=PHOTOGRAPH)


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
