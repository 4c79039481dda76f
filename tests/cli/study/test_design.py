import csv
import json
import xml.etree.ElementTree as ET

import pytest

import periscopy_sim as ps
from periscopy_sim.evaluation import design as designs

SMALL = ("--hidden", "3x4", "-D", "resolution=12", "--images", "bars")
pytestmark = pytest.mark.usefixtures("jit", "few_lights")


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


@pytest.mark.thorough
@pytest.mark.usefixtures("drawings")
def test_map_is_drawn(succeeds, tmp_path):
    succeeds(*design("--vary", "occluder_dx=-0.05:0.05,occluder_dz=0:0.05", "--grid", "2"))
    assert len(rows_of(tmp_path / "out")) == 5
    assert (tmp_path / "out" / "design.png").stat().st_size > 10_000


def test_design_that_stopped_goes_on_and_ends_in_the_same_bytes(
    periscopy, succeeds, refused, tmp_path, monkeypatch
):
    asked = ("--vary", "occluder_dx=-0.05:0.05", "--grid", "4", "--by", "reported")
    succeeds(*design(*asked, out="whole"))
    errors_of, count = designs.errors_of, 0

    def stops(*arguments, **more):
        nonlocal count
        count += 1
        if count == 4:  # the first is the given scene
            raise KeyboardInterrupt
        return errors_of(*arguments, **more)

    monkeypatch.setattr(designs, "errors_of", stops)
    assert periscopy(*design(*asked)).code == 130
    assert len(rows_of(tmp_path / "out")) == 3
    assert "snr" in refused(*design(*asked, "--snr", "50"))
    succeeds(*design(*asked))
    assert count == 4 + 2
    for name in ("design.csv", "best.xml", "design.json"):
        whole, resumed = ((tmp_path / each / name).read_bytes() for each in ("whole", "out"))
        assert whole == resumed, name


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
