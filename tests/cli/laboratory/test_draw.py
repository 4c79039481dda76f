import pytest
from PIL import Image

from periscopy_sim.figures.laboratory import projections

pytestmark = pytest.mark.usefixtures("jit")


@pytest.mark.usefixtures("drawings")
def test_scene_is_drawn_with_its_parameters_and_provenance(succeeds, tmp_path, monkeypatch):
    monkeypatch.setattr(projections, "GRID", 40)
    out = succeeds("draw", "plate", "-D", "occluder_dx=0.03", "--out", "deep/lab.png")
    assert out == "wrote deep/lab.png\n"
    with Image.open(tmp_path / "deep" / "lab.png") as picture:
        assert picture.size[0] == 1600
        assert picture.text["command"] == "periscopy draw plate -D occluder_dx=0.03"
        assert "scene_sha256" in picture.text
    assert [path.name for path in (tmp_path / "deep").iterdir()] == ["lab.png"]


def test_what_cannot_be_drawn_is_refused(refused):
    assert "lab.jpg" in refused("draw", "plate", "--out", "lab.jpg")
    assert "'height'" in refused("draw", "plate", "-D", "height=1", "--out", "lab.png")
