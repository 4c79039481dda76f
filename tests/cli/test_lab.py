import pytest
from PIL import Image

from periscopy_sim.figures import laboratory
from periscopy_sim.laboratory.document import EXAMPLE
from periscopy_sim.rendering.scene_files import read_document
from periscopy_sim.scenario import load_scenario

pytestmark = pytest.mark.usefixtures("jit")


def test_example_is_printed_as_it_stands_and_makes_a_scene(succeeds, tmp_path):
    printed = succeeds("lab", "--example")
    assert printed == EXAMPLE.read_text("utf-8")
    (tmp_path / "mine.yaml").write_text(printed)
    succeeds("lab", "mine.yaml", "--out", "deep/lab.xml")
    assert {path.name for path in (tmp_path / "deep").iterdir()} == {"lab.xml", "lab_cylinder.ply"}
    scenario = load_scenario(tmp_path / "deep" / "lab.xml", (2, 3), {"stem_radius": "0.03"})
    assert len(scenario.scene.occluders) == 7
    declared = read_document(tmp_path / "deep" / "lab.xml").defaults
    assert {name.removesuffix("_error") for name in declared if name.endswith("_error")} == {
        *("target_x", "target_z", "monitor_x", "monitor_z", "monitor_turn"),
        *("shade_x", "shade_y", "shade_z", "picture_x", "picture_y"),
    }  # what `calibrate` frees


def test_mistake_is_one_line_and_nothing_is_written(refused, tmp_path):
    text = EXAMPLE.read_text("utf-8")
    assert "distance: 1.05 m +- 0 mm" in text
    (tmp_path / "mine.yaml").write_text(text.replace("distance: 1.05 m +- 0 mm", "distance: 1.05"))
    message = refused("lab", "mine.yaml", "--out", "lab.xml")
    assert message.startswith("mine.yaml: line ") and "wall.distance" in message


@pytest.mark.usefixtures("drawings")
def test_scene_is_drawn_with_its_parameters_and_provenance(succeeds, tmp_path, monkeypatch):
    monkeypatch.setattr(laboratory, "GRID", 40)
    out = succeeds("draw", "plate", "-D", "occluder_dx=0.03", "--out", "deep/lab.png")
    assert out == "wrote deep/lab.png\n"
    with Image.open(tmp_path / "deep" / "lab.png") as picture:
        assert picture.size[0] == 1584  # 7.2 inches
        assert picture.text["command"] == "periscopy draw plate -D occluder_dx=0.03"
        assert "scene_sha256" in picture.text
    assert [path.name for path in (tmp_path / "deep").iterdir()] == ["lab.png"]


def test_what_cannot_be_drawn_is_refused(refused):
    assert "lab.jpg" in refused("draw", "plate", "--out", "lab.jpg")
    assert "'height'" in refused("draw", "plate", "-D", "height=1", "--out", "lab.png")
