"""The way that a user goes, with commands that answer what they are told to."""

import json
from pathlib import Path

import numpy as np
import pytest

from experiments.laboratories import commands, overall, stages
from experiments.laboratories.making.laboratories import LABORATORIES
from experiments.laboratories.stages import Parameter, Way, Workplace
from experiments.report import Verdict

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


def test_overall_counts_determined_parameters_within_their_errors():
    def parameter(strays, determined):
        return Parameter("x", 0.0, 1.0 + strays * 0.1, 0.1, 1.0, determined)

    good = [parameter(k / 10, True) for k in range(19)]
    for bad, verdict in ((1, Verdict.AGREES), (2, Verdict.DIFFERS)):
        found = [*good, *[parameter(3.5, True)] * bad, parameter(9, False)]
        assert overall.confidence([Way("lamp", 0, [], found)]).verdict is verdict
