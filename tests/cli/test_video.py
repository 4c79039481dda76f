import csv
import json

import numpy as np
import pytest
from PIL import Image

import periscopy_sim as ps
from periscopy_sim.reconstruction.preconditioned import Video

pytestmark = pytest.mark.usefixtures("jit", "few_lights")

PAPER = ("--method", "preconditioned")
FILES = {"frames", "frames.npy", "metrics.csv", "residual.png", "summary.json", "video.png"}


@pytest.fixture
def video(succeeds, tiny, tmp_path):
    """Reconstruct a sequence into `out`; return the frames, the summary and the table."""

    def run(given, *options):
        succeeds("video", given, *tiny, *PAPER, *options, "--out", "out")
        with (tmp_path / "out" / "metrics.csv").open(newline="") as stream:
            table = list(csv.DictReader(stream))
        summary = json.loads((tmp_path / "out" / "summary.json").read_text())
        return np.load(tmp_path / "out" / "frames.npy"), summary, table

    return run


def fitted(transport, scenario, **settings):
    B = ps.point_light_backgrounds(scenario)
    return ps.Periscope.for_scene(scenario, transport, B, **settings)


def next_frames(photographs, periscope, **settings):
    """What the method makes of photographs that come one at a time."""
    method = Video(periscope, **settings)
    return np.array([method.next_frame(y) for y in photographs])


def column(table, name):
    return np.array([float(row[name]) for row in table])


def test_frames_are_those_of_the_coupling_asked_for(
    photographs, transport, scenario, video, tmp_path
):
    np.save(tmp_path / "y.npy", photographs)
    settings = {"coupling": "total-variation", "temporal_weight": 3.0}
    frames, summary, _ = video("y.npy", "--coupling", "total-variation", "--temporal-weight", "3")
    expected = next_frames(photographs, fitted(transport, scenario), **settings)
    assert np.allclose(frames, expected, rtol=1e-3, atol=2e-3 * expected.max())
    assert summary["first_frame"]["explicit"] is True
    assert {name: summary[name] for name in settings} == settings
    assert "l1_weight" not in summary


def test_folder_holds_frames_pictures_table_and_summary(photographs, video, clip, tmp_path):
    np.save(tmp_path / "y.npy", photographs)
    np.save(tmp_path / "clip.npy", clip)
    frames, summary, table = video("y.npy", "--truth", "clip.npy", "--seed", "3", "--rate", "25")
    folder = tmp_path / "out"
    assert {path.name for path in folder.iterdir()} == FILES | {"frames_sheet.png"}
    assert sorted(path.name for path in (folder / "frames").iterdir()) == [
        f"{k:04d}.png" for k in range(3)
    ]
    expected = {"photographs": "y.npy", "frames": 3, "method": "preconditioned", "rate": 25.0}
    assert {name: summary[name] for name in expected} == expected
    assert [int(row["frame"]) for row in table] == list(range(3))
    for name in ("seconds", "noise", "lambda", "kappa"):
        assert summary["median"][name] == np.median(column(table, name)) > 0
    with Image.open(folder / "video.png") as picture:
        assert picture.info["scene_sha256"] == summary["provenance"]["scene_sha256"]
        picture.seek(2)
        assert picture.info["duration"] == pytest.approx(40)
    psnr = [ps.psnr_gain_matched(frame, image) for frame, image in zip(frames, clip, strict=True)]
    assert np.allclose(column(table, "psnr"), psnr, atol=1e-3)
    assert summary["median"]["psnr"] == pytest.approx(np.median(psnr), abs=1e-3)
    np.save(tmp_path / "short.npy", photographs[:2])  # nothing of a longer video stays
    frames, _, _ = video("short.npy", "--coupling", "none")
    assert len(frames) == 2 == len(list((folder / "frames").iterdir()))


def test_animation_is_written_as_videos_too(photographs, video, tmp_path):
    av = pytest.importorskip("av")
    np.save(tmp_path / "y.npy", photographs)
    _, summary, _ = video("y.npy", "--also", "webm", "--also", "mp4", "--rate", 8)
    assert summary["formats"] == ["png", "webm", "mp4"]
    for ending in ("mp4", "webm"):
        with av.open(str(tmp_path / "out" / f"video.{ending}")) as container:
            assert float(container.streams.video[0].average_rate) == 8
            assert len(list(container.decode(video=0))) == 3


def test_impossible_option_is_refused(refused, clip, tiny, tmp_path):
    np.save(tmp_path / "y.npy", np.random.default_rng(0).uniform(1, 2, (3, 24, 24, 3)))
    np.save(tmp_path / "two.npy", clip[:2])
    for options, offender in [
        (("--coupling", "none", "--l1-weight", "1"), "--l1-weight"),
        (("--also", "avi"), "avi"),
        (("--truth", "two.npy"), "two.npy"),
    ]:
        assert offender in refused("video", "y.npy", *tiny, *PAPER, *options, "--out", "out")


def test_light_that_bounces_is_warned_of(succeeds, clip, scenario, tmp_path):
    """Photographs without noise, and hardly any ambient light that could explain the bounces."""
    y = (ps.transport(scenario).astype(float) @ clip.reshape(3, 20, 3)).reshape(3, 24, 24, 3)
    y *= scenario.channel_gain
    y += 1e-6 * y.mean() * np.random.default_rng(0).standard_normal(y.shape)
    np.save(tmp_path / "y.npy", y)
    np.save(tmp_path / "B.npy", np.ones((576, 1)))
    scene = "--scene", "chair", "-D", "resolution=24", "--hidden", "4x5", "--light-model", "B.npy"
    succeeds("video", "y.npy", *scene, "--out", "out")
    warnings = json.loads((tmp_path / "out" / "summary.json").read_text())["warnings"]
    assert any("--bounces all" in line for line in warnings)
