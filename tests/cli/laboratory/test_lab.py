import pytest

from periscopy_sim.laboratory.document import EXAMPLE
from periscopy_sim.rendering.scene.document import read_document
from periscopy_sim.rendering.scene.load import load_scenario

pytestmark = pytest.mark.usefixtures("jit")


def test_example_is_printed_as_it_stands_and_makes_a_scene(succeeds, tmp_path):
    printed = succeeds("lab", "--example")
    assert printed == EXAMPLE.read_text("utf-8")
    (tmp_path / "mine.yaml").write_text(printed)
    told = succeeds("lab", "mine.yaml", "--out", "deep/lab.xml").splitlines()
    assert told[0] == "wrote deep/lab.xml, deep/lab_cylinder.ply"
    assert "periscopy draw deep/lab.xml --out deep/lab.png" in told[1]
    assert {path.name for path in (tmp_path / "deep").iterdir()} == {"lab.xml", "lab_cylinder.ply"}
    scenario = load_scenario(tmp_path / "deep" / "lab.xml", (2, 3), {"stem_radius": "0.03"})
    assert len(scenario.occluders) == 7
    declared = read_document(tmp_path / "deep" / "lab.xml").defaults
    assert {name.removesuffix("_error") for name in declared if name.endswith("_error")} == {
        *("target_x", "target_z", "monitor_x", "monitor_z", "monitor_turn"),
        *("shade_x", "shade_y", "shade_z", "picture_x", "picture_y"),
    }  # what `calibrate` frees


@pytest.mark.parametrize(
    ("old", "new", "said"),
    [
        ("distance: 1.05 m +- 0 mm", "distance: 1.05", "wall.distance: 1.05 has no unit"),
        (
            "end: [50 cm +- 0 mm, 58 cm +- 0 mm, 30 cm",
            "end: [52 cm +- 0 mm, 58 cm +- 0 mm, 2 cm",
            "start and end are one point",
        ),
        ("kind: box  ", "kind: mesh\n    file: none.stl\n    unit: mm  ", "is not known"),
    ],
)
def test_mistake_is_one_line_and_nothing_is_written(refused, tmp_path, old, new, said):
    text = EXAMPLE.read_text("utf-8")
    assert old in text
    (tmp_path / "mine.yaml").write_text(text.replace(old, new, 1))
    message = refused("lab", "mine.yaml", "--out", "lab.xml")
    assert message.startswith("mine.yaml: ") and said in message
    assert ": line " in message or "called" in said  # two entries have no line in common
