import importlib
import json
import xml.etree.ElementTree as ET
from dataclasses import replace

import numpy as np
import pytest
from PIL import Image

import periscopy_sim as ps
from periscopy_sim.calibration.prior import scene_covariance, start_values
from periscopy_sim.calibration.result import Rival
from periscopy_sim.rendering.scene_files import read_document
from tests.scenes.calibration import calibration

pytestmark = pytest.mark.usefixtures("jit")

SCENE = ("--scene", "chair", "-D", "resolution=32", "--hidden", "6x7")
MOVED = {"occluder_dx": 0.007, "occluder_dz": -0.006}
FREE = ("--free", ",".join(MOVED))
MIXING = np.array([[1, -0.8, 0], [0, 1, -0.8], [-0.8, 0, 1]])


@pytest.fixture(scope="module")
def signals():
    """Photographs without ambient light of a chair that is not where its scene says."""
    scenario = ps.load_scenario("chair", (6, 7), {"resolution": 32, **MOVED})
    A = ps.render_transport(scenario, samples=64, seed=9)
    images = [ps.read_hidden_image(ps.find_image(n), (6, 7)) for n in ("mushroom", "still_life")]
    return [(A @ image.reshape(-1, 3)).reshape(32, 32, 3) for image in images]


@pytest.fixture
def photograph(signals, tmp_path):
    """The first, under ambient light, in another camera's channels, as y.npy."""
    scenario = ps.load_scenario("chair", (6, 7), {"resolution": 32})
    ambient = ps.point_light_backgrounds(scenario)[:, 40].reshape(32, 32, 1)
    off = np.tile(ambient / ambient.mean(), 3)
    clean = ps.composite(signals[0], off, 0.5)
    np.save(tmp_path / "y.npy", ps.add_noise(ps.ColourMatrix(MIXING).mix(clean), 60, 3))
    np.save(tmp_path / "M.npy", MIXING)
    (tmp_path / "M.json").write_text(json.dumps(MIXING.tolist()))
    np.save(tmp_path / "off.npy", ps.add_noise(off, 60, 4))


@pytest.mark.thorough
@pytest.mark.usefixtures("photograph")
def test_moved_chair_is_found_and_its_scene_written(periscopy, tmp_path):
    outcome = periscopy(
        "calibrate", "y.npy", *SCENE, *FREE, "--monitor-off", "off.npy", "--out", "new/found.xml",
        "--uncertain", "monitor_dx=0.005", "--colour-matrix", "M.npy",
    )  # fmt: skip
    assert (outcome.code, outcome.err) == (0, "")
    assert all(name in outcome.out for name in ("found.xml", "found.json", *MOVED))
    record = json.loads((tmp_path / "new/found.json").read_text())
    assert record["backgrounds"] == ["off.npy"]
    assert record["colour_matrix"] == MIXING.tolist()
    assert record["trusted"] and record["better_than_start"]
    for name, truth in MOVED.items():
        parameter = record["parameters"][name]
        assert parameter["value"] == pytest.approx(truth, abs=1.5e-3)
        assert parameter["ruler_error"] == 0.005 and parameter["determined"]
    assert max(record["unexplained"]) < min(0.0025, *record["unexplained_before"])
    with Image.open(tmp_path / "new/found.png") as picture:
        assert picture.info["command"].startswith("periscopy calibrate")
    defaults = {
        element.get("name"): element.get("value")
        for element in ET.parse(tmp_path / "new/found.xml").iter("default")
    }
    for name in MOVED:
        assert float(defaults[name]) == pytest.approx(record["parameters"][name]["value"], rel=1e-8)
    calibrated = read_document(tmp_path / "new/found.xml")
    known = scene_covariance(calibrated)
    assert known.trusted and known.names == (*MOVED, "monitor_dx")
    assert known.changed(calibrated) == []


ASIDE = [dict(zip(MOVED, (dx, 0.001), strict=True)) for dx in (0.002, 0.003)]


@pytest.fixture
def files(tmp_path):
    """Photographs of nothing, with the monitor on and off, and colour matrices."""
    light = np.random.default_rng(0).uniform(1, 2, (2, 32, 32, 3))
    for name, values in {"y": light[0], "off": light[1], "M": MIXING}.items():
        np.save(tmp_path / f"{name}.npy", values)
    (tmp_path / "M.json").write_text(json.dumps(MIXING.tolist()))


@pytest.fixture
def rivals(files, monkeypatch):  # noqa: ARG001
    """Let the calibration of any photograph find two other scenes; return what it was given."""
    named = tuple(replace(p, name=n) for p, n in zip(calibration().parameters, MOVED, strict=True))
    found = replace(
        calibration(), parameters=named, rivals=tuple(Rival(each, 0.3) for each in ASIDE),
        images=(np.ones((6, 7, 3)),) * 3,
    )  # fmt: skip
    module = importlib.import_module("periscopy_sim.calibration.calibrate")
    given = []
    monkeypatch.setattr(module, "calibrate", lambda *of, **how: given.append((of, how)) or found)
    return given


def test_a_scene_whose_image_lies_aside_is_written_too(rivals, succeeds, tmp_path):
    said = succeeds(
        "calibrate", "y.npy", *SCENE, "--free", "occluder_dx=0.004,occluder_dz", "--uncertain",
        "monitor_dx=0.005", "--monitor-off", "off.npy", "--colour-matrix", "M.npy", "--out",
        "found.xml",
    )  # fmt: skip
    (((wall,), *_), options) = rivals[0]
    assert options["free"] == {"occluder_dx": 0.004, "occluder_dz": None}
    assert options["uncertain"] == {"monitor_dx": 0.005} and options["shown"] == []
    np.testing.assert_array_equal(wall.colour_matrix.matrix, MIXING)
    assert list(wall.monitor_off) == ["off.npy"]
    for name, values in zip(("found_aside1.xml", "found_aside2.xml"), ASIDE, strict=True):
        assert f"{name} (about 30 %; " in said
        document = read_document(tmp_path / name)
        written = start_values(document, tuple(values))
        assert written.tolist() == [*values.values()]
        assert scene_covariance(document).changed(document) == []
    record = json.loads((tmp_path / "found.json").read_text())
    assert [each["values"] for each in record["rivals"]] == ASIDE


@pytest.mark.usefixtures("rivals")
def test_nothing_is_written_if_a_scene_aside_cannot_be(refused, tmp_path):
    (tmp_path / "found_aside2.xml").mkdir()
    line = refused("calibrate", "y.npy", *SCENE, *FREE, "--out", "found.xml")
    assert "found_aside2.xml" in line


@pytest.mark.thorough
@pytest.mark.usefixtures("every_wall_point")
def test_known_picture_and_another_photograph_serve(signals, succeeds, tmp_path):
    for number, signal in enumerate(signals):
        np.save(tmp_path / f"{number}.npy", ps.add_noise(signal, 60, number))
    given = ("calibrate", "0.npy", "1.npy", *SCENE, *FREE, "--shown", "mushroom")
    succeeds(*given, "--out", "found.xml")
    record = json.loads((tmp_path / "found.json").read_text())
    for name, truth in MOVED.items():
        assert record["parameters"][name]["value"] == pytest.approx(truth, abs=1e-3)
    assert np.array(record["colour_matrix"]) == pytest.approx(np.eye(3), abs=0.12)
    assert record["shown"] == ["mushroom"] and len(record["photographs"]) == 2


@pytest.mark.usefixtures("files")
def test_what_cannot_be_calibrated_is_refused(refused):
    for options, offender in [
        (("--free", "occluder_x"), "'occluder_dx'"),
        (("--free", "resolution"), "'resolution'"),
        ((*FREE, "--out", "found.json"), ".xml"),
        ((*FREE, "--shown", "mushroom", "--shown", "mushroom"), "shown pictures"),
        ((*FREE, "--cells", "4x4"), "--cells"),
        ((*FREE, "--shown", "mushroom", "--colour-matrix", "M.npy"), "colour matrix: leave"),
        ((*FREE, "--colour-matrix", "M.json", "--out", "M.xml"), "M.json"),
    ]:
        out = () if "--out" in options else ("--out", "found.xml")
        assert offender in refused("calibrate", "y.npy", *SCENE, *options, *out)
