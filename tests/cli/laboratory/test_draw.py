import pytest
from PIL import Image

from periscopy_sim.figures.laboratory import overview, projections

pytestmark = pytest.mark.usefixtures("jit")


@pytest.mark.usefixtures("drawings")
def test_scene_is_drawn_with_its_parameters_and_provenance(succeeds, tmp_path, monkeypatch):
    monkeypatch.setattr(overview, "COLUMNS", {True: 160})
    monkeypatch.setattr(projections, "GRID", {True: 40})
    out = succeeds("draw", "plate", "-D", "occluder_dx=0.03", "--out", "deep/lab.png")
    assert out == "wrote deep/lab.png\n"
    with Image.open(tmp_path / "deep" / "lab.png") as picture:
        assert picture.size[0] == 1600
        assert picture.text["command"] == "periscopy draw plate -D occluder_dx=0.03"
        assert "scene_sha256" in picture.text
    assert [path.name for path in (tmp_path / "deep").iterdir()] == ["lab.png"]


def test_what_cannot_be_drawn_is_refused(refused):
    assert "lab.jpg: the drawing is written as .png" in refused("draw", "plate", "--out", "lab.jpg")
    assert "does not exist" in refused("draw", "none.xml", "--out", "lab.png")
    assert "'height'" in refused("draw", "plate", "-D", "height=1", "--out", "lab.png")


@pytest.mark.thorough
@pytest.mark.usefixtures("drawings")
@pytest.mark.parametrize(("half", "told"), [(1.5e-4, "0.3 mm"), (15.0, "30 m"), (0.02, None)])
def test_occluder_of_a_wrong_unit_is_told(half, told, periscopy, edited_scene, monkeypatch):
    """It stands behind the monitor, before which a chair casts a shadow."""
    monkeypatch.setattr(overview, "COLUMNS", {True: 160})
    monkeypatch.setattr(projections, "GRID", {True: 40})
    thing = (
        f'<shape type="cube" id="thing"><transform name="to_world"><scale value="{half}"/>'
        f'<translate x="-0.3" y="{-0.1 - half}" z="0.2"/></transform></shape></scene>'
    )
    scene = edited_scene(("</scene>", thing))
    outcome = periscopy("draw", scene, "--out", "lab.png")
    assert outcome.code == 0
    warned = f"occluder 'thing' is {told} large: are its numbers metres?"
    assert (warned in outcome.err) if told else not outcome.err
