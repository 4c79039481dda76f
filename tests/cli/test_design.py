import csv
import json
import xml.etree.ElementTree as ET

import numpy as np
import pytest

import periscopy_sim as ps
from periscopy_sim.cli.design import MEANINGS
from periscopy_sim.evaluation.design import diagnose

pytestmark = pytest.mark.usefixtures("jit", "few_lights")

TINY = ("-D", "resolution=24", "--hidden", "4x5", "--samples", "4")


def test_numbers_are_those_of_the_diagnosis(succeeds, tmp_path):
    options = ("--seed", "3", "--rank-tolerance", "1e-4", "--out", "analysis")
    printed = succeeds("analyze", "chair", *TINY, *options)
    folder = tmp_path / "analysis"
    names = {"summary.json", "bounds.png", "bounds.npy", "bounds_without_background.npy"}
    assert {path.name for path in folder.iterdir()} == names
    assert all(name.replace("_", " ") in printed for name in MEANINGS)
    summary = json.loads((folder / "summary.json").read_text())
    assert (summary["model"], summary["samples"]) == ("rendered", 4)
    scenario = ps.load_scenario(ps.find_scene("chair"), (4, 5), {"resolution": 24})
    A = ps.render_transport(scenario, samples=4, strata="gauss", seed=3)
    expected = diagnose(
        A, ps.point_light_backgrounds(scenario), (24, 24), (4, 5), rank_tolerance=1e-4
    )
    assert expected.background_rank > 3 and summary["identity_error"] < 1e-10
    for name in MEANINGS.keys() - {"identity_error"}:
        assert summary[name] == pytest.approx(getattr(expected, name), rel=1e-6), name
    for name in ("bounds", "bounds_without_background"):
        np.testing.assert_allclose(np.load(folder / f"{name}.npy"), getattr(expected, name))


def test_patches_that_cannot_be_told_apart_are_refused(refused):
    assert "chair.xml" in refused("analyze", "chair", *TINY, "--hidden", "24x24", "--out", "out")


SMALL = ("--hidden", "3x4", "-D", "resolution=12", "--images", "bars")


def rows_of(folder):
    with (folder / "design.csv").open(encoding="utf-8", newline="") as stream:
        return list(csv.DictReader(stream))


def record_of(folder):
    return json.loads((folder / "design.json").read_text("utf-8"))


def design(*arguments, out="out"):
    return ("design", "chair", *SMALL, *arguments, "--out", out)


def test_curve_of_one_parameter_and_the_best_scene(succeeds, tmp_path):
    succeeds(*design("--vary", "occluder_dx=-0.05:0.1", "--grid", "4"))
    record, rows = record_of(tmp_path / "out"), rows_of(tmp_path / "out")
    assert [row["occluder_dx"] for row in rows] == ["0", "-0.05", "0", "0.05", "0.1"]
    assert rows[2]["bound"] == rows[0]["bound"]
    bounds = {row["point"]: float(row["bound"]) for row in rows}
    best = record["best"]
    assert best["bound"] == pytest.approx(min(bounds.values()), rel=1e-6)
    assert record["ranking"] == sorted(map(int, bounds), key=lambda k: bounds[str(k)])
    assert record["provenance"]["scene_sha256"]
    scene = tmp_path / "out" / "best.xml"
    defaults = {e.get("name"): e.get("value") for e in ET.parse(scene).getroot().iter("default")}
    assert defaults["occluder_dx"] == best["occluder_dx"]
    assert ps.load_scenario(scene, (3, 4)).photograph_shape == (12, 12)


def test_point_that_makes_no_scene_fails_by_name_and_the_rest_go_on(periscopy, tmp_path):
    ended = periscopy(*design("--vary", "seat_width=-0.1:0.2", "--grid", "3", "--images", "none"))
    assert ended.code == 0 and "seat_width=-0.1: " in ended.err
    rows, record = rows_of(tmp_path / "out"), record_of(tmp_path / "out")
    assert "'chair_seat'" in rows[1]["failure"] and rows[1]["bound"] == ""
    assert float(rows[2]["bound"]) > 0
    assert "1" in record["failed"] and 1 not in record["ranking"]


def test_what_a_user_can_fix_is_one_line(refused):
    for arguments, offender in [
        (("--vary", "occluder_dx=1:0"), "occluder_dx=1:0"),
        (("--vary", "occluder_dx=0:1,occluder_dy=0:1", "--grid", "1000"), "--grid"),
        (("--vary", "occluder_dx=0:1,occluder_dy=0:1,occluder_dz=0:1"), "one or two"),
        (("--vary", "occluder_dx=0:1", "--sbr", "0"), "--sbr"),
        (("--vary", "ocluder_dx=0:1"), "'occluder_dx'"),
        (("--vary", "occluder_dx_error=0:1"), "occluder_dx_error"),
        (("--vary", "occluder_dx=0:1", "--images", "none", "--by", "reported"), "--by reported"),
        (("--vary", "occluder_dx=0:1", "-D", "seat_width=-0.1"), "'chair_seat'"),
    ]:
        assert offender in refused(*design(*arguments))


def test_scene_that_determines_nothing_has_no_best(periscopy, tmp_path):
    ended = periscopy(*design("--vary", "occluder_dz=0:0.01", "--grid", "2", "--images", "none",
                              "--model", "rendered", "--samples", "4",
                              "-D", "occluder_dy=-2"))  # fmt: skip
    assert ended.code == 0 and ended.err
    assert record_of(tmp_path / "out")["best"] is None
    assert not (tmp_path / "out" / "best.xml").exists()
