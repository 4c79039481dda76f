import numpy as np
import pytest

from periscopy_sim.errors import OutputError
from periscopy_sim.evaluation.design import points_of, ranked, read_table, write_table
from periscopy_sim.evaluation.merit import NUMBERS

RANGES = {"a": (-1.0, 1.0), "b": (10.0, 20.0)}


def row(point, values, *numbers, failure="", remark=""):
    numbers = dict(zip(NUMBERS, [*numbers, *[None] * 6], strict=False))
    return {"point": point, "values": values, **numbers, "failure": failure, "remark": remark}


ROWS = [
    row(0, {"a": "0", "b": "1.5"}, 1.0, 0.1, 0.05, 1.0, 0.02, 0.03, remark="a, remark"),
    row(1, {"a": "1", "b": "-2"}, 1.2, float("inf"), 0.05),
    row(2, {"a": "2", "b": "0"}, failure='it hides "all",\nor nearly'),
    row(3, {"a": "2", "b": "0"}, 1.0, 0.09),
]


def test_rows_are_read_as_they_were_written(tmp_path):
    assert read_table(tmp_path / "none.csv", ("a", "b")) == []
    write_table(tmp_path / "design.csv", ROWS)
    assert read_table(tmp_path / "design.csv", ("a", "b")) == ROWS


@pytest.mark.parametrize(("old", "new"), [("0.1", "x"), ("point", "number")])
def test_damage_is_reported(tmp_path, old, new):
    file = tmp_path / "design.csv"
    write_table(file, ROWS)
    file.write_text(file.read_text("utf-8").replace(old, new, 1), "utf-8")
    with pytest.raises(OutputError, match=r"design\.csv"):
        read_table(file, ("a", "b"))


def test_ranking_leaves_out_what_has_no_finite_number():
    assert [each["point"] for each in ranked(ROWS, "bound")] == [3, 0]


def test_grid_combines_all_values_with_their_ends():
    points = points_of(RANGES, 3, 64, 0)
    assert len(points) == 9
    assert points[0] == {"a": "-1", "b": "10"}
    assert points[1] == {"a": "-1", "b": "15"}
    assert points[3] == {"a": "0", "b": "10"}
    assert points[-1] == {"a": "1", "b": "20"}
    assert points_of(RANGES, 1, 64, 0) == [{"a": "0", "b": "15"}]


def test_draws_lie_within_and_a_larger_number_goes_on():
    few, many = (points_of(RANGES, None, count, 3) for count in (7, 40))
    assert many[:7] == few
    assert few != points_of(RANGES, None, 7, 4)
    values = np.array([[float(point[name]) for name in RANGES] for point in many])
    assert (values >= (-1, 10)).all()
    assert (values <= (1, 20)).all()
    # Evenly: each quarter of each range has about a quarter of them.
    for column, (low, high) in zip(values.T, RANGES.values(), strict=True):
        counts, _ = np.histogram(column, 4, (low, high))
        assert np.abs(counts - 10).max() <= 2
