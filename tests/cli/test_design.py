"""`periscopy design`: points fail by name, runs go on, the best scene is written."""

import csv
import json
import xml.etree.ElementTree as ET

import pytest

import periscopy_sim as ps
from periscopy_sim.evaluation.design import Design

SMALL = ("--hidden", "3x4", "-D", "resolution=12", "--samples", "4", "--images", "bars")


@pytest.fixture(autouse=True)
def small(few_lights):
    """Few prototype lights."""


def rows_of(folder):
    with (folder / "design.csv").open(encoding="utf-8", newline="") as stream:
        return list(csv.DictReader(stream))


def design(*arguments, scene="chair", out="out"):
    return ("design", scene, *SMALL, *arguments, "--out", out)


def test_curve_of_one_parameter_and_the_best_scene(succeeds, tmp_path):
    told = succeeds(*design("--vary", "occluder_dx=-0.05:0.1", "--grid", "4"))
    record = json.loads((tmp_path / "out" / "design.json").read_text("utf-8"))
    rows = rows_of(tmp_path / "out")
    assert [row["occluder_dx"] for row in rows] == ["0", "-0.05", "0", "0.05", "0.1"]
    assert rows[2]["bound"] == rows[0]["bound"]
    bounds = {row["point"]: float(row["bound"]) for row in rows}
    best = record["best"]
    assert best["bound"] == pytest.approx(min(bounds.values()), rel=1e-6)
    assert record["ranking"] == sorted(map(int, bounds), key=lambda k: bounds[str(k)])
    assert record["provenance"]["scene_sha256"]
    assert (tmp_path / "out" / "design.png").is_file()
    scene = tmp_path / "out" / "best.xml"
    defaults = {e.get("name"): e.get("value") for e in ET.parse(scene).getroot().iter("default")}
    assert defaults["occluder_dx"] == best["values"]["occluder_dx"]
    assert defaults["resolution"] == "12"
    assert ps.load_scenario(scene, (3, 4)).photograph_shape == (12, 12)
    assert "given scene (occluder_dx=0)" in told


def test_point_that_makes_no_scene_fails_by_name_and_the_rest_go_on(periscopy, tmp_path):
    ended = periscopy(*design("--vary", "occluder_dy=-0.63:0.43", "--grid", "3",
                              "-D", "occluder_dx=-0.25", "--images", "none"))  # fmt: skip
    assert ended.code == 0
    rows = rows_of(tmp_path / "out")
    assert "'chair_seat'" in rows[1]["failure"]
    assert rows[1]["failure"].endswith("stands in the monitor")
    assert rows[1]["bound"] == ""
    assert float(rows[2]["bound"]) > 0
    assert "occluder_dy=-0.63: " in ended.err
    record = json.loads((tmp_path / "out" / "design.json").read_text("utf-8"))
    assert "1" in record["failed"]
    assert 1 not in record["ranking"]


@pytest.mark.usefixtures("drawings")
def test_map_and_ranking_are_drawn(succeeds, tmp_path):
    succeeds(*design("--vary", "occluder_dx=-0.05:0.05,occluder_dz=0:0.05", "--grid", "2"))
    succeeds(*design("--vary", "occluder_dx=-0.05:0.05,occluder_dz=0:0.05,seat_width=0.05:0.09",
                     "--draws", "3", "--by", "told", "--equal", "time", out="more"))  # fmt: skip
    assert len(rows_of(tmp_path / "out")) == 5
    assert len(rows_of(tmp_path / "more")) == 4
    for folder in ("out", "more"):
        assert (tmp_path / folder / "design.png").stat().st_size > 10_000


def test_design_that_stopped_goes_on_and_ends_in_the_same_bytes(
    periscopy, succeeds, tmp_path, monkeypatch
):
    asked = ("--vary", "occluder_dx=-0.05:0.05", "--draws", "4")
    succeeds(*design(*asked, out="whole"))
    row, count = Design.row, 0

    def stops(self, *point):
        nonlocal count
        count += 1
        if count == 4:  # the first is the scene as it stands
            raise KeyboardInterrupt
        return row(self, *point)

    monkeypatch.setattr(Design, "row", stops)
    ended = periscopy(*design(*asked))
    assert (ended.code, "goes on where it stopped" in ended.err) == (130, True)
    assert len(rows_of(tmp_path / "out")) == 3
    succeeds(*design(*asked))
    assert count == 4 + 1 + 2
    for name in ("design.csv", "best.xml", "design.json"):
        whole, resumed = ((tmp_path / each / name).read_bytes() for each in ("whole", "out"))
        assert whole == resumed, name


def test_folder_of_another_design_is_refused(succeeds, refused):
    asked = ("--vary", "occluder_dx=-0.05:0.05", "--draws", "1", "--images", "none")
    succeeds(*design(*asked))
    assert "holds another design (snr 60.0, here 50.0)" in refused(*design(*asked, "--snr", "50"))


@pytest.mark.parametrize(
    ("arguments", "words"),
    [
        (("--vary", "occluder_dx=1:0"), "NAME=LOW:HIGH"),
        (("--vary", "occluder_dx=0:1,occluder_dy=0:1", "--grid", "1000"), "--draws"),
        (("--vary", "ocluder_dx=0:1"), "did you mean 'occluder_dx'"),
        (("--vary", "occluder_dx_error=0:1"), "vary occluder_dx"),
        (("--vary", "occluder_dx=0:1", "--images", "none", "--by", "told"), "--by told needs"),
        (("--vary", "occluder_dx=0:1", "-D", "occluder_dx=-0.25", "-D", "occluder_dy=-0.63"),
         "stands in the monitor"),
    ],
)  # fmt: skip
def test_what_a_user_can_fix_is_one_line(refused, arguments, words):
    assert words in refused(*design(*arguments))


def test_scene_that_tells_nothing_has_no_best(periscopy, tmp_path):
    ended = periscopy(*design("--vary", "occluder_dz=0:0.01", "--draws", "1", "--images", "none",
                              "-D", "occluder_dy=-2"))  # fmt: skip
    assert ended.code == 0
    assert "no point is best" in ended.err
    assert not (tmp_path / "out" / "best.xml").exists()
