"""The way that a user goes, with commands that answer what they are told to."""

import json
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from experiments.laboratories import commands, confidence, overall, stages
from experiments.laboratories.making.laboratories import LABORATORIES
from experiments.laboratories.stages import Parameter, Stage, Way, Workplace
from experiments.report import Verdict
from periscopy_sim.evaluation.metrics import psnr

LAMP = LABORATORIES["lamp"]
SHIFT = 0.004


@pytest.fixture
def place(tmp_path, monkeypatch):
    """A laboratory whose files are empty, and commands that write what the real ones do."""
    place = Workplace(tmp_path / "out", tmp_path / "rendered", 1)
    truth = place.rendered / "lamp" / "truth"
    truth.mkdir(parents=True)
    np.save(truth / "hidden.npy", np.full((18, 32, 3), 0.5))
    values = {"made_from": "x", "true": {"occluder_x": 0.507}}
    (truth / "values.json").write_text(json.dumps(values))
    from experiments.laboratories.making import render

    monkeypatch.setattr(render, "make", lambda laboratory, out: out / laboratory.name)
    monkeypatch.setattr(stages, "package_sha256", lambda: "code")
    calls = []

    def periscopy(*words):
        calls.append(words)
        out = Path(words[words.index("--out") + 1])
        if words[0] == "prepare":
            out.touch()
        elif words[0] == "calibrate":
            told = {
                "start": 0.5, "value": 0.507 + SHIFT, "standard_error": 0.001, "determined": True,
            }  # fmt: skip
            record = {"parameters": {"occluder_x": told}, "trusted": True, "doubts": []}
            out.with_suffix(".json").write_text(json.dumps(record))
        else:
            out.mkdir(parents=True)
            np.save(out / "reconstruction.npy", np.full((18, 32, 3), 0.5, np.float32))
            better = 10 * ("--monitor-off" in words)
            told = {"psnr": 15.0 + better, "psnr_registered": 16.0 + better, "unexplained": 0.01}
            (out / "summary.json").write_text(json.dumps(told))
        return ""

    monkeypatch.setattr(commands, "periscopy", periscopy)
    return place, calls


def test_each_step_gets_what_it_stands_for(place):
    place, calls = place
    gone = stages.way(LAMP, 0, place)
    assert [stage.name for stage in gone.stages] == list(stages.STAGES)
    assert [stage.psnr for stage in gone.stages] == [15, 25, 15, 15, 25, 25]
    pictures = [call for call in calls if call[0] == "reconstruct"]
    scenes = [Path(call[call.index("--scene") + 1]).name for call in pictures]
    assert scenes == [
        "scene.xml", "scene.xml", "ruler_camera.xml", "ruler.xml", "ruler.xml",
        "ruler_calibrated.xml",
    ]  # fmt: skip
    for call in calls:
        # Only the reference knows the scene's truth; the commands' --truth adds metrics.
        told = [str(word) for word in call if "truth" in str(word)]
        known = [word for word in told if not word.endswith("hidden.png") and word != "--truth"]
        assert all("ways/lamp/true/" in str(call[call.index("--out") + 1]) for _ in known)
    photographs = [call for call in calls if call[0] == "prepare"]
    assert len(photographs) == 5  # each once
    points = [("--points" in call) for call in photographs]
    assert points == [False, False, False, True, True]


def test_a_way_that_was_gone_is_read(place):
    place, calls = place
    first = stages.way(LAMP, 0, place)
    number = len(calls)
    assert stages.way(LAMP, 0, place) == first
    assert len(calls) == number


def test_a_bent_lens_is_straightened_before_the_true_scene_too(place):
    place, calls = place
    bent = replace(LAMP, camera=replace(LAMP.camera, distortion=0.1))
    stages.way(bent, 0, place)
    assert "--points" in calls[0]


def test_a_step_that_fails_costs_only_those_that_need_it(place, monkeypatch):
    place, _ = place
    answer = commands.periscopy

    def periscopy(*words):
        if words[0] == "calibrate":
            raise commands.CommandError("periscopy calibrate: error: no")
        return answer(*words)

    monkeypatch.setattr(commands, "periscopy", periscopy)
    gone = stages.way(LAMP, 0, place)
    assert [bool(stage.failure) for stage in gone.stages] == [False] * 5 + [True]
    assert np.isnan(gone.stage(stages.CALIBRATED).psnr)
    section = stages.run(LAMP, place)
    assert section.claims[0].verdict is Verdict.DIFFERS  # NaN is no success
    assert "error: no" in section.tables[0].rows[0][-1]


@pytest.mark.thorough
def test_the_page_shows_every_ruler(place):
    place, _ = place
    section = stages.run(LAMP, replace(place, rulers=2))
    assert len(section.pictures) == 2
    assert all(picture.file.is_file() for picture in section.pictures)
    assert section.claims[0].measured == "0.0 dB"
    assert section.tables[1].rows[0][:2] == ["occluder_x", "0.507"]


def test_the_best_shift_is_of_three_patches_also_of_a_way_that_was_gone_before(place):
    place, _ = place
    truth = np.random.default_rng(0).uniform(0.2, 0.8, (18, 32, 3))
    np.save(place.rendered / "lamp" / "truth" / "hidden.npy", truth)
    stages.way(LAMP, 0, place)
    for down, seen in ((3, True), (4, False)):
        picture = np.roll(truth, down, axis=0)
        picture[:down] = 0
        for file in place.out.rglob("reconstruction.npy"):
            np.save(file, picture)
        found = stages.way(LAMP, 0, place).stage(stages.CALIBRATED).registered
        back = psnr(np.roll(picture, -down, axis=0), truth)
        assert (abs(found - back) < 1e-9) == seen


def way_of(before, after, shift=0.0):
    """Stages at so many dB, before a true scene of 25; the calibrated one's is shifted."""
    decibels = {
        stages.TRUE: 25.0,
        stages.TRUE_OFF: 25.0,
        stages.BACKGROUND: before,
        stages.CALIBRATED: after,
    }
    found = [Stage(name, "", psnr, psnr) for name, psnr in decibels.items()]
    found[-1] = replace(found[-1], psnr=after - shift)
    return Way("lamp", 0, found)


@pytest.mark.parametrize(
    ("ways", "verdicts"),
    [
        ([way_of(20, 21.5)], [Verdict.AGREES, Verdict.AGREES]),
        ([way_of(20, 20.5)], [Verdict.DIFFERS, Verdict.AGREES]),
        ([way_of(23, 22.5)], [Verdict.AGREES, Verdict.DIFFERS]),
        ([way_of(20, 15), way_of(20, 24), way_of(20, 24)], [Verdict.AGREES, Verdict.DIFFERS]),
    ],
)
def test_claims_are_the_median_loss_and_the_worst_gain(ways, verdicts):
    assert [claim.verdict for claim in stages.claims(ways)] == [*verdicts, *verdicts]


def test_a_shifted_picture_is_good_only_after_its_shift():
    as_it_stands, registered = [Verdict.DIFFERS] * 2, [Verdict.AGREES] * 2
    found = [claim.verdict for claim in stages.claims([way_of(20, 24, shift=5.0)])]
    assert found == [*as_it_stands, *registered]


def test_overall_asks_for_the_median_and_counts_every_harm():
    ways = [way_of(20, 24, shift=5.0), way_of(20, 21.5), way_of(20, 19.5)]
    assert overall.loss(ways).verdict is Verdict.AGREES  # 1, 3.5 and 5.5 dB
    assert overall.loss([*ways, ways[-1]]).verdict is Verdict.DIFFERS  # 4.5 dB
    assert [claim.measured for claim in overall.harm(ways)] == ["2 of 3", "1 of 3"]
    assert [claim.verdict for claim in overall.harm(ways[1:2])] == [Verdict.AGREES] * 2


def test_a_calibration_that_failed_is_no_success_overall():
    failed = replace(way_of(20, 24), stages=[*way_of(20, 24).stages[:-1], Stage(stages.CALIBRATED)])
    assert overall.loss([failed]).verdict is Verdict.DIFFERS
    assert [claim.measured for claim in overall.harm([failed])] == ["1 of 1", "1 of 1"]


def test_overall_shows_every_way_of_every_laboratory(place, monkeypatch):
    place, _ = place
    monkeypatch.setattr(stages, "LABORATORIES", {"lamp": LAMP, "again": LAMP})
    section = overall.run(replace(place, rulers=2))
    assert [row[:2] for row in section.tables[0].rows] == [["lamp", "0"], ["lamp", "1"]] * 2


def test_confidence_counts_what_is_told_as_determined():
    def parameter(strays, determined):
        return Parameter("x", 0.0, 1.0 + strays * 0.1, 0.1, 1.0, determined)

    good = [parameter(k / 10, True) for k in range(19)]
    assert confidence.claim([*good, parameter(3.5, True)]).verdict is Verdict.AGREES
    assert confidence.claim([*good[1:], *[parameter(-3.5, True)] * 2]).verdict is Verdict.DIFFERS
    ways = [Way("lamp", 0, [], [parameter(9, False), *good])]
    assert len(confidence.told_as_determined(ways)) == 19


def test_a_commands_own_line_is_told():
    with pytest.raises(commands.CommandError, match=r"periscopy reconstruct: .*"):
        commands.periscopy("reconstruct", "no_such_photograph.exr")
