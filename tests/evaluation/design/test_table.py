import pytest

from periscopy_sim.errors import OutputError
from periscopy_sim.evaluation.design.merit import Merit
from periscopy_sim.evaluation.design.table import Row, read_table, write_table

ROWS = [
    Row(0, {"a": "0", "b": "1.5"}, Merit(1.0, 0.1, 0.05, 1.0, 0.02, 0.03, "a, remark")),
    Row(1, {"a": "1", "b": "-2"}, Merit(1.2, float("inf"), 0.05, None)),
    Row(2, {"a": "2", "b": "0"}, None, 'it hides "all",\nor nearly'),
]


def test_rows_come_back_as_they_were(tmp_path):
    write_table(tmp_path / "design.csv", ("a", "b"), ROWS)
    assert read_table(tmp_path / "design.csv", ("a", "b")) == ROWS
    assert read_table(tmp_path / "none.csv", ("a", "b")) == []


@pytest.mark.parametrize(
    "damage",
    [
        lambda text: text.replace("0.1", "x", 1),
        lambda text: text.replace("point", "number", 1),
        lambda text: text.replace("\n1,1", "\n7,1"),
        lambda text: text[: text.rindex('"')],
        lambda text: text.replace("\n2,2,0,,,,,,,", "\n2,2,0,,,,,,,,"),
    ],
)
def test_damage_is_told(tmp_path, damage):
    file = tmp_path / "design.csv"
    write_table(file, ("a", "b"), ROWS)
    file.write_text(damage(file.read_text("utf-8")), "utf-8")
    with pytest.raises(OutputError, match="is damaged"):
        read_table(file, ("a", "b"))
