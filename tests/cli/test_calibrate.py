import importlib
import json
from dataclasses import replace

import numpy as np
import pytest

from periscopy_sim.calibration.prior import scene_covariance, start_values
from periscopy_sim.calibration.result import Rival
from periscopy_sim.rendering.scene_files import read_document
from tests.scenes.calibration import calibration

pytestmark = pytest.mark.usefixtures("jit")

SCENE = ("--scene", "chair", "-D", "resolution=32", "--hidden", "6x7")
MOVED = {"occluder_dx": 0.007, "occluder_dz": -0.006}
FREE = ("--free", ",".join(MOVED))
MIXING = np.array([[1, -0.8, 0], [0, 1, -0.8], [-0.8, 0, 1]])


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
    assert record["backgrounds"] == ["off.npy"]
    assert record["colour_matrix"] == MIXING.tolist()


@pytest.mark.usefixtures("rivals")
def test_nothing_is_written_if_a_scene_aside_cannot_be(refused, tmp_path):
    (tmp_path / "found_aside2.xml").mkdir()
    line = refused("calibrate", "y.npy", *SCENE, *FREE, "--out", "found.xml")
    assert "found_aside2.xml" in line


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
