import json
import xml.etree.ElementTree as ET

import numpy as np
import pytest
from PIL import Image

import periscopy_sim as ps
from periscopy_sim.calibration import parameters
from periscopy_sim.calibration.prior import declared_errors
from periscopy_sim.calibration.scene_covariance import scene_covariance
from periscopy_sim.calibration.search import global_search, ruled_starts
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
    """Search a centimetre about the start, at few points: hundreds take most of the time."""
    monkeypatch.setattr(parameters, "SPREAD", 0.1)
    monkeypatch.setattr(global_search, "FIRST", 16)
    monkeypatch.setattr(global_search, "LATER", 4)
    monkeypatch.setattr(ruled_starts, "PLACES", 2)
    monkeypatch.setattr(ruled_starts, "DESCENTS", 2)


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
    printed = outcome.out
    assert "wrote new/found.xml, new/found.json, new/found.png\n" in printed
    record = json.loads((tmp_path / "new/found.json").read_text())
    assert record["backgrounds"] == ["off.npy"]
    assert record["trusted"] and record["doubts"] == [] and record["better_than_start"]
    assert set(record["parameters"]) == set(MOVED)
    for name, truth in MOVED.items():
        told = record["parameters"][name]
        assert told["value"] == pytest.approx(truth, abs=1.5e-3)
        assert told["ruler_error"] == 0.005 and told["determined"]
        assert 0 < told["statistical_error"] < 1.5e-3
        assert f"{name}  " in printed
    # Were the monitor further to the right, the chair would be, too, by less.
    moves = record["uncertain"]["monitor_dx"]["moves"]
    assert 1e-3 < moves["occluder_dx"] < 1e-2
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
    ("options", "offender"),
    [
        (("--free", "occluder_x"), "did you mean 'occluder_dx'?"),
        (("--free", "occluder_dx_error"), "'occluder_dx'"),
        (("--free", "resolution"), "'resolution'"),
        (("--free", "occluder_dy", "-D", "occluder_dy=0.37"), "through the wall"),
        (("--free", "occluder_dx", "--out", "found.json"), ".xml"),
        (("--free", "occluder_dx=near"), "--free occluder_dx=near"),
        (("-D", "occluder_dx_error=-1"), "'occluder_dx_error' is -1"),
        (("--free", "occluder_dx", "--background", "y.npy"), "is the photograph itself"),
        (("--free", "occluder_dx", "--uncertain", "monitor_z=1"), "did you mean 'monitor_dz'?"),
        (("--free", "occluder_dx", "--uncertain", "occluder_dx=1"), "'occluder_dx'"),
        (("--free", "occluder_dx", "-D", "occluder_dx=3"), "no occluder casts a shadow"),
    ],
)
def test_what_cannot_be_calibrated_is_refused(photograph, refused, tmp_path, options, offender):
    np.save(tmp_path / "y.npy", photograph)
    out = () if "--out" in options else ("--out", "found.xml")
    assert offender in refused("calibrate", "y.npy", *SCENE, *options, *out)


def test_a_textured_wall_is_refused(photograph, refused, edited_scene, tmp_path):
    np.save(tmp_path / "y.npy", photograph)
    paint = '<texture type="checkerboard" name="reflectance"/>'
    scene = edited_scene(('<rgb name="reflectance" value="0.8"/>', paint))
    given = ("--scene", scene, *SCENE[2:], "--free", "occluder_dx", "--out", "found.xml")
    assert "textured" in refused("calibrate", "y.npy", *given)


def test_a_photograph_of_too_few_pixels_is_refused(refused, tmp_path):
    np.save(tmp_path / "y.npy", 1 + np.arange(48.0).reshape(4, 4, 3))
    scene = ("--scene", "chair", "-D", "resolution=4", "--hidden", "2x2")
    arguments = ("calibrate", "y.npy", *scene, "--free", "occluder_dx", "--out", "found.xml")
    assert "too few" in refused(*arguments)


def test_nothing_that_was_given_is_overwritten(photograph, refused, tmp_path):
    np.savez(tmp_path / "y.npz", photograph=photograph)
    (tmp_path / "y.npz").rename(tmp_path / "y.json")  # what it is called does not matter
    arguments = ("calibrate", "y.json", *SCENE, "--free", "occluder_dx", "--out", "y.xml")
    assert "y.json: it is one of the files given" in refused(*arguments)


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
    assert "occluder_dx" in outcome.err
    record = json.loads((tmp_path / "found.json").read_text())
    assert not record["trusted"] and record["doubts"] == record["warnings"]
    assert not any(told["determined"] for told in record["parameters"].values())
    assert "NOT TO BE TRUSTED: occluder_dx ended" in (tmp_path / "found.xml").read_text()
    assert ps.load_scenario(tmp_path / "found.xml", (6, 7)).photograph_shape == (32, 32)
