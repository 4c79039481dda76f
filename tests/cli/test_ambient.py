import pytest

from periscopy_sim.storage.formats.rasters import read_exr

pytestmark = pytest.mark.usefixtures("few_paths")
COMMAND = ("ambient", "overcast", "--scene", "chair", "-D", "resolution=12", "--target", "0.01")


@pytest.mark.usefixtures("jit")
def test_light_is_rendered_once_and_kept_with_its_error(succeeds, refused, monkeypatch, tmp_path):
    shown = succeeds(*COMMAND, "--seed", "5", "--out", "new/out")
    file = tmp_path / "new" / "out" / "overcast.exr"
    assert list(file.parent.iterdir()) == [file] and str(file.relative_to(tmp_path)) in shown
    picture, held = read_exr(file)
    assert picture.shape == (12, 12, 3) and picture.min() > 0
    assert picture.std() < 0.2 * picture.mean()  # a grey sky
    assert 0 < (held["relative_error"] ** 2 + held["brightness_error"] ** 2) ** 0.5 <= 0.01
    assert (held["ambient"], held["seed"], held["target"]) == ("overcast", "5", "0.01")
    assert held["scene"].endswith("chair.xml") and "12" in held["parameters"]
    assert {"variant", "mitsuba", "scene_sha256", "ambient_sha256"} <= held.keys()
    render = "periscopy_sim.rendering.ambient.background.render_background"
    monkeypatch.setattr(render, lambda *_, **__: pytest.fail("rendered again"))
    before = file.read_bytes()
    assert succeeds(*COMMAND, "--seed", "5", "--out", "new/out") == shown
    assert file.read_bytes() == before
    assert refused(*COMMAND, "--seed", "1", "--out", "new/out").startswith("new/out/overcast.exr: ")


def test_unknown_condition_is_refused(refused):
    assert "'midnight'" in refused("ambient", "overcast", "midnight", *COMMAND[2:], "--out", "out")
