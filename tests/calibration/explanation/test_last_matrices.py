import numpy as np
import pytest
from periscopy_sim.calibration.explanation.last_matrices import KEPT, LastMatrices


def test_the_last_places_are_computed_once_and_those_before_anew():
    computed, last = [], LastMatrices()

    def at(place):
        def compute():
            computed.append(place)
            return np.full((2, 3), place, np.float32)

        return last.at(place, compute)

    for place in (*range(KEPT), 0, KEPT, 0, 1):
        np.testing.assert_array_equal(at(place), np.full((2, 3), place))
    # 0 was looked at again before KEPT came; 1 was not, and went.
    assert computed == [*range(KEPT), KEPT, 1]


def test_what_is_kept_cannot_be_written_to():
    A = LastMatrices().at("here", lambda: np.zeros((2, 3), np.float32))
    with pytest.raises(ValueError, match="read-only"):
        A += 1


def test_a_place_that_fails_is_not_kept():
    last = LastMatrices()
    with pytest.raises(ZeroDivisionError):
        last.at("here", lambda: 1 / 0)
    assert last.at("here", lambda: np.ones((1, 1), np.float32)) == 1
