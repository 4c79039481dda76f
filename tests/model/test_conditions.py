import numpy as np
import pytest

from periscopy_sim.hidden import Hidden
from periscopy_sim.model.fit import Fit

GAIN = np.array([1.2, 1.0, 0.8])


def test_eight_bits_are_taken_as_linear_with_a_warning():
    seen = Fit(np.ones((12, 2)), hidden=Hidden.of((1, 2)))
    with pytest.warns(UserWarning, match="8-bit"):
        planes = seen.planes(np.full((1, 12, 3), 7, np.uint8))
    assert (planes == 7).all()


def test_grey_photographs_show_no_colour_of_the_wall_and_others_need_one_for_each_channel():
    A, hidden = np.random.default_rng(40).uniform(0.1, 1, (126, 12)), Hidden.of((3, 4))
    fit = Fit(A, hidden=hidden, channel_gain=GAIN)
    np.testing.assert_array_equal(fit.gain(1), [[1]])
    np.testing.assert_array_equal(fit.gain(3), [GAIN])
    with pytest.raises(ValueError, match="4 channels, the wall's colour 3"):
        fit.planes(np.random.default_rng(0).random((1, 126, 4)))
    assert (Fit(A, hidden=hidden, channel_gain=np.ones(3)).gain(4) == 1).all()
