"""Searches of a box, where no ruler tells about where the values are: when they go on, and end."""

import numpy as np
import pytest
from periscopy_sim.calibration.search.image_shift import ImageShift

from periscopy_sim.calibration import calibrate_levels as search
from periscopy_sim.errors import SceneError
from tests.calibration.conftest import ERRING, TRUTH, calibrated


@pytest.fixture
def boxes(monkeypatch):
    """Have the searches of boxes end where is said, by turns; give what they are about."""

    def search_to(*ends):
        begun = []

        def explore(_, start, *__):
            begun.append(start)
            return ends[len(begun) - 1]

        monkeypatch.setattr(search, "explore", explore)
        return begun

    return search_to


@pytest.mark.usefixtures("doubted", "held")
def test_a_search_in_doubt_goes_on_about_where_it_ended(boxes):
    begun = boxes(TRUTH + 0.03, TRUTH)
    assert calibrated(TRUTH + 0.07, [np.inf, np.inf]).trusted
    np.testing.assert_array_equal(begun, [TRUTH + 0.07, TRUTH + 0.03])


@pytest.mark.usefixtures("doubted", "held")
def test_one_that_is_believed_ends(boxes):
    begun = boxes(TRUTH)
    assert calibrated(TRUTH + 0.07, [np.inf, np.inf]).trusted
    assert len(begun) == 1


@pytest.mark.usefixtures("doubted", "held")
def test_the_search_ends_where_a_box_has_nothing_better(boxes):
    begun = boxes(TRUTH + 0.03, TRUTH + 0.03)
    found = calibrated(TRUTH + 0.07, [np.inf, np.inf])
    assert len(begun) == 2 and not found.trusted
    np.testing.assert_array_equal(list(found.values.values()), TRUTH + 0.03)


@pytest.mark.usefixtures("held")
@pytest.mark.parametrize("first", [TRUTH, TRUTH + 0.06], ids=["it", "another"])
def test_what_ended_outside_of_its_box_is_believed_within_the_next(boxes, first):
    """Ends are compared as they look near the end: a gain fitted at the start favours the wrong."""
    far = TRUTH + np.array([0.6, 0.0])
    begun = boxes(first, TRUTH)
    found = calibrated(far, [np.inf, np.inf])
    assert found.parameters[0].spread < 0.5
    assert found.trusted
    np.testing.assert_array_equal(list(found.values.values()), TRUTH)
    np.testing.assert_array_equal(begun, [far, first])


@pytest.mark.usefixtures("doubted", "held")
def test_a_later_search_that_fails_costs_nothing_of_what_was_found(boxes, failing):
    begun = boxes(TRUTH + 0.06, TRUTH, TRUTH + 0.012, TRUTH + 0.012)
    failing([(TRUTH, SceneError("it left the physical"))])
    found = calibrated(TRUTH + 0.07, [np.inf, np.inf])
    np.testing.assert_array_equal(list(found.values.values()), TRUTH + 0.012)
    np.testing.assert_array_equal(begun[2], TRUTH + 0.06)


def test_what_shifts_the_image_and_no_ruler_knows_is_not_determined(monkeypatch):
    monkeypatch.setattr(search, "explore", lambda _, start, *__, **___: start)
    start, shift = ERRING, ImageShift(np.array([[2.0, 0.0], [0.0, 0.0]]))
    middle, _ = (found := calibrated(start, [np.inf, 0.02], shift)).parameters
    assert not middle.determined
    assert middle.scale <= middle.spread <= middle.standard_error < np.inf
    assert np.isfinite(found.correlation).all()
