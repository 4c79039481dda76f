import shutil
import warnings

import numpy as np
import pytest

from periscopy_sim.cli import ambient
from periscopy_sim.rendering.ambient.background import render_background
from periscopy_sim.shipped import find_scene, scenes_folder
from periscopy_sim.storage.ambient_library import find_condition
from periscopy_sim.storage.formats.exr import read_exr, write_exr

pytestmark = pytest.mark.usefixtures("few_paths")
jit = pytest.mark.usefixtures("jit")
COMMAND = ("ambient", "overcast", "--scene", "chair", "-D", "resolution=12", "--target", "0.01")


def changed(old, new):
    return tuple(new if part == old else part for part in COMMAND)


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


@pytest.mark.thorough
@jit
def test_same_command_writes_the_same_bytes(succeeds, tmp_path):
    for folder in ("a", "b"):
        succeeds(*COMMAND, "--out", folder)
    assert contents(tmp_path / "a") == contents(tmp_path / "b")


@jit
def test_first_and_later_runs_get_the_same_photograph(periscopy, monkeypatch):
    kept = []
    found = ambient.ambient_photographs

    def spy(*arguments, **options):
        kept.append(found(*arguments, **options))
        return kept[-1]

    monkeypatch.setattr(ambient, "ambient_photographs", spy)
    for _ in range(2):
        assert periscopy(*COMMAND, "--out", "out").code == 0
    first, second = (photographs["overcast"] for photographs in kept)
    assert first.dtype == np.float64
    assert first.tobytes() == second.tobytes()


@pytest.mark.thorough
@jit
@pytest.mark.parametrize(
    ("command", "told"),
    [
        ((*COMMAND, "--seed", "1"), "seed 0, here 1"),
        (changed("0.01", "0.02"), "target 0.01, here 0.02"),
        (changed("chair", "plate"), "scene_sha256"),
        ((*COMMAND, "-D", "occluder_dx=0.01"), "was made otherwise (parameters"),
        (changed("resolution=12", "resolution=10"), "has 12x12 pixels, the scene's camera 10x10"),
    ],
)
def test_file_that_was_made_otherwise_is_refused(command, told, succeeds, refused):
    succeeds(*COMMAND, "--out", "out")
    line = refused(*command, "--out", "out")
    assert line.startswith("out/overcast.exr: ")
    assert told in line
    assert line.endswith("name another folder or remove it")


@jit
def test_edited_place_is_noticed(succeeds, refused, tmp_path):
    lamp = (
        '<scene version="3.0.0"><include filename="board.xml"/><emitter type="point">'
        '<point name="position" value="0.5, 0, 1"/></emitter></scene>'
    )
    (tmp_path / "lamp.xml").write_text(lamp)
    shutil.copy(find_scene("ambient/overcast").parent / "parts" / "board.xml", tmp_path)
    command = ("ambient", "lamp.xml", *COMMAND[2:], "--out", "out")
    succeeds(*command)
    assert (tmp_path / "out" / "lamp.exr").is_file()
    (tmp_path / "lamp.xml").write_text(lamp.replace("0.5, 0, 1", "0.6, 0, 1"))
    assert "was made otherwise (ambient_sha256" in refused(*command)


@jit
def test_scene_may_lie_elsewhere_later(succeeds, edited_scene, tmp_path):
    scene = edited_scene()
    command = ("ambient", "overcast", *COMMAND[4:], "--out", "out", "--scene")
    succeeds(*command, scene)
    before = contents(tmp_path / "out")
    (tmp_path / "moved").mkdir()
    shutil.copy(scene, tmp_path / "moved" / "edited.xml")
    succeeds(*command, str(tmp_path / "moved" / "edited.xml"))
    assert contents(tmp_path / "out") == before


@jit
def test_picture_of_another_size_is_refused(succeeds, refused, tmp_path):
    succeeds(*COMMAND, "--out", "out")
    file = tmp_path / "out" / "overcast.exr"
    picture, held = read_exr(file)
    write_exr(file, picture[:-1], held)
    line = refused(*COMMAND, "--out", "out")
    assert "overcast.exr: was made otherwise (pixels (11, 12)" in line


@jit
def test_foreign_and_damaged_files_are_refused(refused, tmp_path):
    (tmp_path / "out").mkdir()
    file = tmp_path / "out" / "overcast.exr"
    write_exr(file, np.ones((12, 12, 3)), {})
    assert "was made otherwise" in refused(*COMMAND, "--out", "out")
    file.write_bytes(file.read_bytes()[:200])
    assert "overcast.exr" in refused(*COMMAND, "--out", "out")


@jit
@pytest.mark.parametrize("name", ["midnight", "chair", "missing.xml"])
def test_unknown_condition_lists_the_known_ones(name, refused, tmp_path):
    line = refused("ambient", "overcast", name, *COMMAND[2:], "--out", "out")
    assert line.startswith(f"no ambient condition '{name}'; there are high_sun, low_sun, overcast")
    assert "snow" in line
    assert list(tmp_path.iterdir()) == []


@jit
def test_condition_given_twice_is_refused(refused):
    line = refused("ambient", "overcast", "snow", "overcast", *COMMAND[2:], "--out", "out")
    assert "given twice" in line


@jit
def test_interrupt_says_how_to_go_on(monkeypatch, periscopy, succeeds, tmp_path):
    def interrupt(*_, **__):
        raise KeyboardInterrupt

    succeeds(*COMMAND, "--out", "out")
    before = contents(tmp_path / "out")
    monkeypatch.setattr("periscopy_sim.rendering.ambient.background.render_background", interrupt)
    outcome = periscopy("ambient", "overcast", "low_sun", *COMMAND[2:], "--out", "out")
    assert outcome.code == 130
    assert outcome.err == (
        "periscopy: error: interrupted; the same command goes on where it stopped\n"
    )
    assert contents(tmp_path / "out") == before


@jit
def test_missed_target_is_a_warning(periscopy, monkeypatch, tmp_path):
    def short(*arguments, **options):
        return render_background(*arguments, **options, max_rounds=1)

    monkeypatch.setattr("periscopy_sim.rendering.ambient.background.render_background", short)
    with warnings.catch_warnings():
        warnings.simplefilter("default")
        outcome = periscopy(*changed("0.01", "0.00001"), "--out", "out")
    assert outcome.code == 0
    assert outcome.err.startswith("periscopy: warning: 'overcast' stopped at a relative error of")
    assert outcome.err.count("\n") == 1
    assert (tmp_path / "out" / "overcast.exr").is_file()


@pytest.mark.parametrize("target", ["0", "-1", "2", "tiny"])
def test_impossible_target_is_refused(target, refused):
    assert "'--target'" in refused(*changed("0.01", target), "--out", "out")


def test_every_shipped_condition_is_known():
    shipped = {path.stem for path in (scenes_folder() / "ambient").glob("*.xml")}
    assert {*ambient.REALISTIC, *ambient.ADVERSARIAL} == shipped
    assert all(find_condition(name).stem == name for name in shipped)
