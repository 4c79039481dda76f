"""What `periscopy video` recovers, writes and tells."""

import numpy as np
import pytest
from PIL import Image, ImageSequence

import periscopy_sim as ps
from periscopy_sim.reconstruction.noise_aware.video import NoiseAwareVideo
from periscopy_sim.reconstruction.preconditioned.video import Video

pytestmark = pytest.mark.usefixtures("jit", "few_lights")

PAPER = ("--method", "preconditioned")
FILES = {"frames", "frames.npy", "metrics.csv", "residual.png", "summary.json", "video.png"}


@pytest.fixture(scope="session")
def tiny(tiny):
    return (*tiny, *PAPER)


def fitted(transport, scenario, **settings):
    B = ps.point_light_backgrounds(scenario)
    return ps.Periscope.for_scene(scenario, transport, B, **settings)


def next_frames(photographs, periscope, **settings):
    """What the method makes of photographs that come one at a time."""
    method = Video(periscope, **settings)
    return np.array([method.next_frame(y) for y in photographs])


def column(table, name):
    return np.array([float(row[name]) for row in table])


# -- what is recovered and written ---------------------------------------------------------------


@pytest.mark.parametrize(
    ("options", "settings"),
    [
        ((), {"coupling": "l1"}),
        (
            ("--coupling", "total-variation", "--temporal-weight", "3"),
            {"coupling": "total-variation", "temporal_weight": 3.0},
        ),
        (("--coupling", "none"), {"coupling": "none"}),
    ],
)
def test_frames_are_those_of_the_coupling_asked_for(
    options, settings, few_photographs, transport, scenario, video, tmp_path
):
    np.save(tmp_path / "y.npy", few_photographs)
    frames, summary, _ = video("y.npy", *options, "--batch", "2")
    expected = next_frames(few_photographs, fitted(transport, scenario), **settings)
    assert np.allclose(frames, expected, rtol=1e-3, atol=2e-3 * expected.max())
    assert summary["first_frame"]["explicit"] is True
    assert {name: summary[name] for name in settings} == settings
    weight = {"total-variation": {"temporal_weight"}, "l1": {"l1_weight"}, "none": set()}
    assert {"temporal_weight", "l1_weight"} & summary.keys() == weight[summary["coupling"]]


@pytest.mark.thorough
@pytest.mark.parametrize(
    ("options", "settings"),
    [
        (("--batch", "2", "--l1-weight", "3"), {"coupling": "l1", "l1_weight": 3.0}),
        (("--coupling", "none"), {"coupling": "none"}),
    ],
)
def test_frames_are_those_of_the_noise_aware_video(
    options, settings, photographs, transport, scenario, video, tmp_path
):
    np.save(tmp_path / "y.npy", photographs)
    frames, summary, table = video("y.npy", "--method", "noise-aware", *options)
    B = ps.point_light_backgrounds(scenario)
    still = ps.NoiseAware.for_scene(scenario, transport, B)
    method = NoiseAwareVideo(still, **settings)
    expected = [method.solve_next(y) for y in photographs]
    images = np.array([found.image for found in expected])
    assert np.allclose(frames, images, rtol=1e-4, atol=1e-5 * images.max())
    assert [int(row["iterations"]) for row in table] == [found.iterations for found in expected]
    noise = [np.sqrt(np.mean(found.noise**2)) for found in expected]
    assert np.allclose([float(row["noise"]) for row in table], noise, rtol=1e-4)
    assert np.allclose([float(row["lambda"]) for row in table], [f.weight for f in expected])
    assert {name: summary[name] for name in settings} == settings


@pytest.mark.usefixtures("drawings")
def test_folder_holds_frames_pictures_table_and_summary(
    photographs, transport, scenario, succeeds, tiny, results, without_doubts, tmp_path
):
    np.save(tmp_path / "y.npy", photographs)
    arguments = ("video", "y.npy", *tiny, "--seed", "3", "--rate", "25", "--out", "new/out")
    out = succeeds(*arguments)
    folder = tmp_path / "new" / "out"
    assert {path.name for path in folder.iterdir()} == FILES
    assert {path.name for path in (folder / "frames").iterdir()} == {
        f"{k:04d}.png" for k in range(9)
    }
    assert out.startswith("wrote new/out/frames, ")
    _, summary, table = results(folder)
    expected = {
        "photographs": "y.npy",
        "frames": 9,
        "hidden_shape": [4, 5],
        "method": "preconditioned",
        "coupling": "l1",
        "l1_weight": Video(fitted(transport, scenario)).l1_weight,
        "rate": 25.0,
    }
    assert {name: summary[name] for name in expected} == expected
    assert without_doubts(summary["warnings"]) == []  # so few samples leave more than noise
    assert [int(row["frame"]) for row in table] == list(range(9))
    for name in ("seconds", "noise", "lambda", "kappa"):
        assert summary["median"][name] == np.median(column(table, name)) > 0
    provenance = summary["provenance"]
    assert provenance["seed"] == 3
    for name in ("video.png", "frames/0003.png"):
        with Image.open(folder / name) as picture:
            assert picture.info["scene_sha256"] == provenance["scene_sha256"]
    with Image.open(folder / "video.png") as picture:
        picture.seek(8)
        assert picture.info["duration"] == pytest.approx(40)


# -- pictures and errors -------------------------------------------------------------------------


def test_animation_is_written_as_videos_too(photographs, video, tmp_path):
    av = pytest.importorskip("av")
    np.save(tmp_path / "y.npy", photographs)
    _, summary, _ = video("y.npy", "--also", "webm", "--also", "mp4", "--rate", 8)
    assert summary["formats"] == ["png", "webm", "mp4"]
    with Image.open(tmp_path / "out" / "video.png") as picture:
        shown = [np.asarray(each.convert("RGB")) for each in ImageSequence.Iterator(picture)]
    for ending in ("mp4", "webm"):
        with av.open(str(tmp_path / "out" / f"video.{ending}")) as container:
            frames = [each.to_ndarray(format="rgb24") for each in container.decode(video=0)]
            assert float(container.streams.video[0].average_rate) == 8
        assert len(frames) == len(shown) == 9
        for frame, picture in zip(frames, shown, strict=True):
            rows, columns, _ = picture.shape
            assert np.median(abs(frame[:rows, :columns].astype(int) - picture)) < 4


@pytest.mark.parametrize("given", ["clip.npy", "folder", "bars"])
def test_truth_adds_metrics_and_a_contact_sheet(
    given, few_photographs, succeeds, clip, tiny, results, tmp_path
):
    np.save(tmp_path / "y.npy", few_photographs)
    np.save(tmp_path / "clip.npy", clip[:3])
    (tmp_path / "folder").mkdir()
    codes = np.random.default_rng(0).integers(0, 256, (3, 4, 5, 3)).astype(np.uint8)
    for k, code in enumerate(codes):
        Image.fromarray(code).save(tmp_path / "folder" / f"{k}.png")
    shown = codes / 255
    bars = ps.read_hidden_image(ps.find_image("bars"), (4, 5))
    truth = {
        "clip.npy": clip[:3],
        "folder": np.where(shown <= 0.04045, shown / 12.92, ((shown + 0.055) / 1.055) ** 2.4),
        "bars": np.stack([bars] * 3),
    }[given]
    succeeds("video", "y.npy", *tiny, "--truth", given, "--out", "out")
    frames, summary, table = results(tmp_path / "out")
    expected = [ps.psnr(frame, image) for frame, image in zip(frames, truth, strict=True)]
    assert np.allclose(column(table, "psnr"), expected, atol=1e-3)
    assert summary["median"]["psnr"] == pytest.approx(np.median(expected), abs=1e-3)
    assert summary["truth"] == given and (tmp_path / "out" / "frames_sheet.png").is_file()


# -- warnings ------------------------------------------------------------------------------------


def test_what_holds_for_many_photographs_is_said_once(periscopy, tiny, results, tmp_path):
    (tmp_path / "y").mkdir()
    for k in range(5):
        codes = np.random.default_rng(k).integers(99, 256, (24, 24, 3)).astype(np.uint8)
        Image.fromarray(codes).save(tmp_path / "y" / f"{k}.png")
    (tmp_path / "y" / "notes.txt").write_text("x")
    outcome = periscopy("video", "y", *tiny, "--out", "out")
    lines = [line.partition("warning: ")[2] for line in outcome.err.splitlines()]
    assert outcome.code == 0 and len(lines) == 3
    assert "notes.txt" in lines[0] and "y/0.png: 8-bit" in lines[1] and "4 more" in lines[1]
    assert results(tmp_path / "out")[1]["warnings"] == lines


# -- what is refused -----------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("options", "message"),
    [
        (("--coupling", "none", "--l1-weight", "1"), "--l1-weight belongs to --coupling l1"),
        (("--also", "avi"), "avi"),
        (("--truth", "three.npy"), "three.npy: holds 3 hidden images for 9 photographs"),
        (("--truth", "dark.npy"), "dark.npy, frame 4: has negative, NaN or infinite values"),
        (("--truth", "empty"), "empty: holds no file named"),
    ],
)
def test_impossible_option_is_refused(options, message, refused, clip, tiny, tmp_path):
    np.save(tmp_path / "y.npy", np.random.default_rng(0).uniform(1, 2, (9, 24, 24, 3)))
    np.save(tmp_path / "three.npy", clip[:3])
    np.save(tmp_path / "dark.npy", np.where(np.arange(9)[:, None, None, None] == 4, -1, clip))
    (tmp_path / "empty").mkdir()
    assert message in refused("video", "y.npy", *tiny, *options, "--out", "out")


def test_pictures_of_a_longer_video_are_not_mixed_with_this_one(
    photographs, video, refused, tiny, tmp_path
):
    np.save(tmp_path / "y.npy", photographs)
    np.save(tmp_path / "short.npy", photographs[:4])
    video("y.npy")
    line = refused("video", "short.npy", *tiny, "--out", "out")
    assert line.startswith("out: holds a longer video")
    frames, _, _ = video("y.npy", "--coupling", "none")  # the same length may replace it
    assert len(frames) == 9
