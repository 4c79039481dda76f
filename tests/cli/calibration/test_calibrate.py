import json
import re
import shutil
import xml.etree.ElementTree as ET

import numpy as np
import pytest
from PIL import Image

import periscopy_sim as ps
from periscopy_sim.calibration import coarse_to_fine
from periscopy_sim.calibration.prior import declared_errors
from periscopy_sim.calibration.scene_covariance import scene_covariance
from periscopy_sim.cli import output

pytestmark = pytest.mark.usefixtures("jit")

SCENE = ("--scene", "chair", "-D", "resolution=32", "--hidden", "6x7", "--samples", "4")
MOVED = {"occluder_dx": 0.007, "occluder_dz": -0.006}


@pytest.fixture(scope="module")
def photograph():
    """A photograph of a chair that is not where its scene says, under ambient light."""
    scenario = ps.load_scenario("chair", (6, 7), {"resolution": 32, **MOVED})
    image = ps.read_hidden_image(ps.find_image("mushroom"), (6, 7))
    signal = ps.render_transport(scenario, samples=64, seed=9) @ image.reshape(-1, 3)
    ambient = ps.point_light_backgrounds(scenario)[:, [40]]
    light = ps.composite(signal.reshape(32, 32, 3), np.tile(ambient.reshape(32, 32, 1), 3), 0.5)
    return ps.add_noise(light, 60, 3)


@pytest.fixture
def near_search(monkeypatch):
    """Look at few places, once."""
    monkeypatch.setattr(coarse_to_fine, "MOST_PLACES", 2)
    monkeypatch.setattr(coarse_to_fine, "ATTEMPTS", 1)


@pytest.mark.slow
def test_a_chair_that_is_far_off_is_found(photograph, succeeds, tmp_path):
    np.save(tmp_path / "y.npy", photograph)
    start = ("-D", "occluder_dx=0.06", "-D", "occluder_dz=-0.05")
    free = ",".join(f"{name}=inf" for name in MOVED)  # no ruler is so wrong
    succeeds("calibrate", "y.npy", *SCENE, *start, "--free", free, "--out", "found.xml")
    record = json.loads((tmp_path / "found.json").read_text())
    for name, truth in MOVED.items():
        told = record["parameters"][name]
        assert told["value"] == pytest.approx(truth, abs=4 * told["standard_error"])
        assert told["standard_error"] < 1e-3


HELD = [
    f"{name}_error=0" for name in declared_errors(ps.find_scene("chair"), {}) if name not in MOVED
]
"""Of what the chair's scene declares, all but two."""


@pytest.mark.thorough
@pytest.mark.usefixtures("drawings")
@pytest.mark.usefixtures("near_search")
def test_a_moved_chair_is_found_and_its_scene_written(photograph, periscopy, tmp_path, monkeypatch):
    """By default what the ruler does not know is free."""
    monkeypatch.setattr(output, "BETWEEN_LINES", -1.0)
    np.save(tmp_path / "y.npy", photograph)
    off = ps.point_light_backgrounds(ps.load_scenario("chair", (6, 7), {"resolution": 32}))[:, 40]
    off = np.tile(off.reshape(32, 32, 1) / off.mean(), 3)
    np.save(tmp_path / "off.npy", ps.add_noise(off, 60, 4))
    rulers = [word for error in HELD for word in ("-D", error)]
    outcome = periscopy(
        "calibrate", "y.npy", *SCENE, *rulers, "--background", "off.npy", "--out", "new/found.xml",
        "--uncertain", "monitor_dx=0.005",
    )  # fmt: skip
    assert (outcome.code, outcome.err) == (0, "")
    assert outcome.stages[:2] == ["loading the scene", "calibrating"]
    assert outcome.stages[-1] == "calibrating: 100 %"
    printed = outcome.out
    assert "wrote new/found.xml, new/found.json, new/found.png\n" in printed
    record = json.loads((tmp_path / "new/found.json").read_text())
    assert record["backgrounds"] == ["off.npy"]
    assert record["trusted"] and record["doubts"] == [] and record["better_than_start"]
    assert set(record["parameters"]) == set(MOVED)
    assert "± 0.005 by the ruler: by the photograph" in printed
    for name, truth in MOVED.items():
        told = record["parameters"][name]
        assert told["value"] == pytest.approx(truth, abs=1.5e-3)
        assert told["ruler_error"] == 0.005 and told["determined"]
        assert 0 < told["statistical_error"] < 1.5e-3
        assert f"{name}  " in printed
    # Were the monitor farther to the right, the chair would be, too, by less.
    moves = record["uncertain"]["monitor_dx"]["moves"]
    assert 1e-3 < moves["occluder_dx"] < 1e-2
    assert "alone; most by monitor_dx)" in printed
    for name, told in record["parameters"].items():
        quadrature = np.hypot(told["statistical_error"], moves[name])
        assert told["standard_error"] == pytest.approx(quadrature)
    assert max(record["unexplained"]) < min(record["unexplained_before"])
    assert [len(level["values"][0]) for level in record["path"]] == [2, 2]
    with Image.open(tmp_path / "new/found.png") as picture:
        assert picture.info["command"].startswith("periscopy calibrate")
    defaults = {
        element.get("name"): element.get("value")
        for element in ET.parse(tmp_path / "new/found.xml").iter("default")
    }
    assert defaults["resolution"] == "32"
    for name in MOVED:
        assert float(defaults[name]) == pytest.approx(record["parameters"][name]["value"], rel=1e-8)
    assert ps.load_scenario(tmp_path / "new/found.xml", (6, 7)).photograph_shape == (32, 32)
    known = scene_covariance(tmp_path / "new/found.xml")
    assert known.trusted and known.names == (*MOVED, "monitor_dx")
    assert known.changed(tmp_path / "new/found.xml", {}) == []
    for k, name in enumerate(MOVED):
        told = record["parameters"][name]
        assert known.covariance[k, k] == pytest.approx(told["standard_error"] ** 2, rel=1e-4)
        assert known.covariance[k, 2] == pytest.approx(0.005 * moves[name], rel=1e-4)
        assert defaults[f"{name}_error"] == "0.005"  # what the ruler said stays


@pytest.mark.parametrize(
    ("options", "message"),
    [
        (("--free", "sofa"), "declares no parameter 'sofa'; it declares occluder_dx (default 0), "),
        (
            ("--free", "occluder_x"),
            "no parameter 'occluder_x'; did you mean 'occluder_dx'?",
        ),
        (("--free", "occluder_dx_error"), "how well the ruler knows 'occluder_dx'"),
        (("--uncertain", "monitor_z=1"), "no parameter 'monitor_z'; did you mean 'monitor_dz'?"),
        (("--free", ","), "no parameter is free"),
        (("--free", "resolution"), "resolution"),
        (("--free", "occluder_dy", "-D", "occluder_dy=0.37"), "through the wall"),
        (("--free", "occluder_dx", "--out", "found.json"), "written as .xml"),
        (("--free", "occluder_dx", "-D", "monitor_dx=far"), "could not parse"),
        (("--free", "occluder_dx=near"), "--free occluder_dx=near: give a number"),
        (("--free", "occluder_dx=0"), "ruler's error 0 of 'occluder_dx': give a positive"),
        (("--free", "occluder_dx=0.1,occluder_dx"), "'occluder_dx' is named twice"),
        (("-D", "occluder_dx_error=-1"), "'occluder_dx_error' is -1; give a standard deviation"),
        (("--free", "occluder_dx", "--background", "y.npy"), "is the photograph itself"),
        (("--free", "occluder_dx", "--uncertain", "resolution"), "declares no resolution_error"),
        (("--free", "occluder_dx", "--uncertain", "monitor_dx,monitor_dx=1"), "named twice"),
        (("--free", "occluder_dx", "--uncertain", "monitor_dx=a"), "give a number"),
        (("--free", "occluder_dx", "--uncertain", "monitor_dx=0"), "give a positive number"),
        (("--free", "occluder_dx", "--uncertain", "occluder_dx=1"), "is both free and uncertain"),
    ],
)
def test_what_cannot_be_calibrated_is_refused(photograph, refused, tmp_path, options, message):
    np.save(tmp_path / "y.npy", photograph)
    out = () if "--out" in options else ("--out", "found.xml")
    assert message in refused("calibrate", "y.npy", *SCENE, *options, *out)


def test_what_is_declared_nowhere_is_refused_before_anything_is_loaded(refused, monkeypatch):
    monkeypatch.setattr("periscopy_sim.cli.inputs.load", None)
    line = refused("calibrate", "y.npy", *SCENE, "--free", "sofa", "--out", "found.xml")
    assert "declares no parameter 'sofa'" in line


def test_a_scene_without_shadows_in_view_is_refused(photograph, refused, tmp_path):
    np.save(tmp_path / "y.npy", photograph)
    aside = ("--free", "occluder_dx", "-D", "occluder_dx=3", "--out", "found.xml")
    line = refused("calibrate", "y.npy", *SCENE, *aside)
    assert (
        "no occluder casts a shadow of the monitor" in line and "add an occluder, or move" in line
    )


def test_a_background_with_the_monitor_on_is_refused(photograph, refused, tmp_path):
    np.save(tmp_path / "y.npy", photograph)
    np.save(tmp_path / "on.npy", ps.add_noise(photograph, 60, 4))
    line = refused(
        "calibrate", "y.npy", *SCENE, "--background", "on.npy", "--out", "found.xml"
    )  # fmt: skip
    assert "on.npy: still shows the monitor" in line


def test_a_textured_wall_is_refused(photograph, refused, edited_scene, tmp_path):
    np.save(tmp_path / "y.npy", photograph)
    paint = '<texture type="checkerboard" name="reflectance"/>'
    scene = edited_scene(('<rgb name="reflectance" value="0.8"/>', paint))
    given = ("--scene", scene, *SCENE[2:], "--free", "occluder_dx", "--out", "found.xml")
    assert "the wall is textured" in refused("calibrate", "y.npy", *given)


def test_a_mask_that_no_coarse_pixel_survives_is_refused(photograph, refused, tmp_path):
    np.save(tmp_path / "y.npy", np.repeat(np.repeat(photograph, 2, 0), 2, 1))
    rows = np.zeros((64, 64), bool)
    rows[::3] = True
    Image.fromarray(rows).save(tmp_path / "mask.png")
    scene = ("--scene", "chair", "-D", "resolution=64", "--hidden", "6x7", "--mask", "mask.png")
    line = refused("calibrate", "y.npy", *scene, "--free", "occluder_dx", "--out", "found.xml")
    assert "mask less of it" in line


def test_the_scene_itself_is_never_overwritten(photograph, refused, tmp_path):
    np.save(tmp_path / "y.npy", photograph)
    scene = tmp_path / "scene.xml"
    scene.write_text(ps.find_scene("plate").read_text())
    line = refused(
        "calibrate", "y.npy", "--scene", "scene.xml", "--hidden", "6x7", "--free", "occluder_dx",
        "--out", "scene.xml",
    )  # fmt: skip
    assert "scene.xml: it is one of the files given" in line


def test_a_black_photograph_is_refused(refused, tmp_path):
    np.save(tmp_path / "y.npy", np.zeros((32, 32, 3)))
    line = refused("calibrate", "y.npy", *SCENE, "--free", "occluder_dx", "--out", "found.xml")
    assert "every value is zero" in line


def test_nothing_that_was_given_is_overwritten(photograph, refused, tmp_path):
    np.savez(tmp_path / "y.npz", photograph=photograph)
    (tmp_path / "y.npz").rename(tmp_path / "y.json")  # what it is called does not matter
    arguments = ("calibrate", "y.json", *SCENE, "--free", "occluder_dx", "--out", "y.xml")
    assert "y.json: it is one of the files given" in refused(*arguments)


@pytest.mark.usefixtures("near_search")
def test_ambient_light_alone_teaches_nothing(refused, tmp_path):
    scenario = ps.load_scenario("chair", (6, 7), {"resolution": 32})
    light = np.tile(ps.point_light_backgrounds(scenario)[:, [40]].reshape(32, 32, 1), 3)
    np.save(tmp_path / "y.npy", ps.add_noise(light / light.mean(), 60, 1))
    arguments = ("calibrate", "y.npy", *SCENE, "--free", "occluder_dx", "--out", "found.xml")
    assert "shows no shadows" in refused(*arguments)


def test_a_photograph_of_too_few_pixels_is_refused(refused, tmp_path):
    np.save(tmp_path / "y.npy", 1 + np.arange(48.0).reshape(4, 4, 3))
    scene = ("--scene", "chair", "-D", "resolution=4", "--hidden", "2x2")
    arguments = ("calibrate", "y.npy", *scene, "--free", "occluder_dx", "--out", "found.xml")
    assert "too few" in refused(*arguments)


def test_a_copy_that_would_name_other_files_is_refused_before_the_search(
    photograph, refused, tmp_path
):
    np.save(tmp_path / "y.npy", photograph)
    folder = tmp_path / "scenes"
    folder.mkdir()
    shutil.copy(ps.find_scene("chair"), folder / "whole.xml")
    (folder / "scene.xml").write_text(
        '<scene version="3.0.0"><include filename="whole.xml"/></scene>'
    )
    (tmp_path / "elsewhere").mkdir()
    shutil.copy(folder / "whole.xml", tmp_path / "elsewhere")
    options = ("-D", "resolution=32", "--hidden", "6x7", "--free", "occluder_dx")
    line = refused(
        "calibrate",
        "y.npy",
        "--scene",
        "scenes/scene.xml",
        *options,
        "--out",
        "elsewhere/found.xml",
    )
    assert "name a file beside the scene" in line and "whole.xml' for a file of" in line
    assert [file.name for file in (tmp_path / "elsewhere").iterdir()] == ["whole.xml"]


@pytest.mark.thorough
@pytest.mark.usefixtures("near_search")
def test_what_leaves_the_ruler_is_not_to_be_trusted_and_nobody_overlooks_it(
    photograph, periscopy, tmp_path
):
    np.save(tmp_path / "y.npy", photograph)
    outcome = periscopy(
        "calibrate", "y.npy", *SCENE, "-D", f"occluder_dz={MOVED['occluder_dz']}",
        "--free", "occluder_dx=0.001", "--out", "found.xml",
    )  # fmt: skip
    assert outcome.code == 0
    assert "THIS CALIBRATION IS NOT TO BE TRUSTED" in outcome.err
    told = " ".join(outcome.err.replace("#", " ").split())
    assert re.search("occluder_dx ended [5-9].* of the ruler's errors", told)
    record = json.loads((tmp_path / "found.json").read_text())
    assert not record["trusted"] and record["doubts"] == record["warnings"]
    assert not any(told["determined"] for told in record["parameters"].values())
    assert "NOT TO BE TRUSTED: occluder_dx ended" in (tmp_path / "found.xml").read_text()
    assert ps.load_scenario(tmp_path / "found.xml", (6, 7)).photograph_shape == (32, 32)
