import pytest

from periscopy_sim.storage.formats.exr import read_exr

pytestmark = pytest.mark.usefixtures("few_paths")
jit = pytest.mark.usefixtures("jit")
COMMAND = ("ambient", "overcast", "--scene", "chair", "-D", "resolution=12", "--target", "0.01")


def contents(folder):
    return {path.name: path.read_bytes() for path in folder.iterdir()}


@jit
def test_file_holds_the_light_and_its_error(succeeds, tmp_path):
    shown = succeeds(*COMMAND, "--seed", "5", "--out", "new/out")
    folder = tmp_path / "new" / "out"
    assert set(contents(folder)) == {"overcast.exr"}
    picture, held = read_exr(folder / "overcast.exr")
    assert picture.shape == (12, 12, 3) and picture.min() > 0
    # A grey sky.
    assert picture.std() < 0.2 * picture.mean()
    assert 0 < held["relative_error"] <= 0.01
    assert held["brightness_error"] > 0
    assert (held["ambient"], held["seed"], held["target"]) == ("overcast", "5", "0.01")
    assert held["scene"].endswith("chair.xml") and "12" in held["parameters"]
    assert {"variant", "mitsuba", "scene_sha256", "ambient_sha256"} <= held.keys()
    whole = (held["relative_error"] ** 2 + held["brightness_error"] ** 2) ** 0.5
    assert whole <= 0.01
    assert f"wrote new/out/overcast.exr  relative error of a pixel {whole:.1e}" in shown


@jit
def test_second_run_reads_what_the_first_wrote(succeeds, monkeypatch, tmp_path):
    shown = succeeds(*COMMAND, "--out", "out")
    before = contents(tmp_path / "out")

    def fail(*_, **__):
        raise AssertionError("rendered again")

    with monkeypatch.context() as patch:
        patch.setattr("periscopy_sim.rendering.ambient.background.render_background", fail)
        assert succeeds(*COMMAND, "--out", "out") == shown.replace("wrote ", "kept ")
    assert contents(tmp_path / "out") == before
    # Conditions that are missing are added, the others kept.
    shown = succeeds("ambient", "low_sun", *COMMAND[1:], "--out", "out").splitlines()
    assert [line.split("  ")[0] for line in shown] == [
        "wrote out/low_sun.exr",
        "kept out/overcast.exr",
    ]
    after = contents(tmp_path / "out")
    assert set(after) == {"overcast.exr", "low_sun.exr"}
    assert after["overcast.exr"] == before["overcast.exr"]


@jit
def test_file_that_was_made_otherwise_is_refused(succeeds, refused):
    succeeds(*COMMAND, "--out", "out")
    assert refused(*COMMAND, "--seed", "1", "--out", "out").startswith("out/overcast.exr: ")


@jit
def test_unknown_condition_lists_the_known_ones(refused):
    line = refused("ambient", "overcast", "midnight", *COMMAND[2:], "--out", "out")
    assert line.startswith("no ambient condition 'midnight'; there are high_sun") and "snow" in line
