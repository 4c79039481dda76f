import numpy as np
import pytest

from periscopy_sim.errors import PeriscopyError
from periscopy_sim.evaluation.design.variation import Variation

RANGES = {"a": (-1.0, 1.0), "b": (10.0, 20.0)}


def test_grid_combines_all_values_with_their_ends():
    points = Variation(RANGES, grid=3).points()
    assert len(points) == 9
    assert points[0] == {"a": "-1", "b": "10"}
    assert points[1] == {"a": "-1", "b": "15"}
    assert points[-1] == {"a": "1", "b": "20"}
    assert Variation(RANGES, grid=1).points() == [{"a": "0", "b": "15"}]


def test_draws_lie_within_and_a_larger_number_goes_on():
    few, many = (Variation(RANGES, draws=count, seed=3).points() for count in (7, 40))
    assert many[:7] == few
    assert few != Variation(RANGES, draws=7, seed=4).points()
    values = np.array([[float(point[name]) for name in RANGES] for point in many])
    assert (values >= (-1, 10)).all()
    assert (values <= (1, 20)).all()
    # Evenly: each quarter of each range has about a quarter of them.
    for column, (low, high) in zip(values.T, RANGES.values(), strict=True):
        counts, _ = np.histogram(column, 4, (low, high))
        assert np.abs(counts - 10).max() <= 2


@pytest.mark.parametrize(
    ("given", "words"),
    [
        ({"ranges": {}}, "nothing varies"),
        ({"ranges": {"a": (1.0, 1.0)}}, "a higher one"),
        ({"ranges": {"a": (2.0, 1.0)}}, "a higher one"),
        ({"ranges": {"a": (0.0, np.inf)}}, "finite"),
        ({"ranges": RANGES, "grid": 1000}, "1000000 points"),
        ({"ranges": RANGES, "draws": 0}, "0 points"),
    ],
)
def test_variation_that_is_none_is_refused(given, words):
    with pytest.raises(PeriscopyError, match=words):
        Variation(**given)
