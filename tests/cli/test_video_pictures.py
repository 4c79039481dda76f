"""The pictures of a reconstructed video, alone and beside the truth, and its errors."""

import sys

import numpy as np
import pytest
from PIL import Image, ImageSequence

import periscopy_sim as ps

pytestmark = pytest.mark.usefixtures("jit", "few_lights")


def column(table, name):
    return np.array([float(row[name]) for row in table])


def animation(path):
    with Image.open(path) as picture:
        shown = [np.asarray(frame.convert("RGB")) for frame in ImageSequence.Iterator(picture)]
        return shown, dict(picture.info)


def linear(codes):
    shown = codes / 255
    return np.where(shown <= 0.04045, shown / 12.92, ((shown + 0.055) / 1.055) ** 2.4)


def test_animation_shows_every_photograph_beside_its_frame(photographs, video, tmp_path):
    np.save(tmp_path / "y.npy", photographs)
    frames, summary, _ = video("y.npy")
    shown, info = animation(tmp_path / "out" / "video.png")
    assert len(shown) == 9 and info["loop"] == 0
    white = np.percentile(photographs, 99.5)
    for picture, photograph, image in zip(shown, photographs, frames, strict=True):
        inside = np.nonzero((picture != 255).any(axis=2).all(axis=1))[0]  # rows of panels
        assert inside.size == 0 or np.ptp(inside) < 245
        # Margins of 12 pixels, titles of 34; patches of 10 and of 60 pixels.
        wall = linear(picture[34:274, 12:252][5::10, 5::10])
        assert np.allclose(wall, np.clip(photograph / white, 0, 1), atol=0.006)
        hidden = linear(picture[34:274, 264:564][30::60, 30::60])
        assert np.allclose(hidden, np.clip(image / summary["white"], 0, 1), atol=0.006)


def test_animation_is_written_as_videos_too(photographs, video, tmp_path):
    av = pytest.importorskip("av")
    np.save(tmp_path / "y.npy", photographs)
    _, summary, _ = video("y.npy", "--also", "webm", "--also", "mp4", "--rate", 8)
    assert summary["formats"] == ["png", "webm", "mp4"]
    shown, _ = animation(tmp_path / "out" / "video.png")
    for ending in ("mp4", "webm"):
        with av.open(str(tmp_path / "out" / f"video.{ending}")) as container:
            frames = [each.to_ndarray(format="rgb24") for each in container.decode(video=0)]
            assert float(container.streams.video[0].average_rate) == 8
        assert len(frames) == len(shown) == 9
        for frame, picture in zip(frames, shown, strict=True):
            rows, columns, _ = picture.shape
            assert np.median(abs(frame[:rows, :columns].astype(int) - picture)) < 4


def test_video_without_its_extra_is_refused_with_what_to_install(refused, tiny, monkeypatch):
    monkeypatch.setitem(sys.modules, "av", None)
    line = refused("video", "y.npy", *tiny, "--also", "mp4", "--out", "out")
    assert "'.[video]'" in line


# -- against the truth ---------------------------------------------------------------------------


def own_metrics(frames, truth):
    errors = []
    for image, wanted in zip(np.maximum(frames.astype(np.float64), 0), truth, strict=True):
        matched = np.empty_like(image)
        for c in range(3):
            x, y = image[..., c].ravel(), wanted[..., c].ravel()
            gain = np.linalg.lstsq(x[:, None], y, rcond=None)[0]
            matched[..., c] = np.clip(gain * image[..., c], 0, 1)
        errors.append(np.mean((matched - wanted) ** 2))
    return np.array(errors)


@pytest.mark.thorough
@pytest.mark.parametrize("given", ["clip.npy", "folder", "bars"])
def test_truth_adds_metrics_and_a_contact_sheet(
    given, photographs, succeeds, clip, tiny, results, tmp_path
):
    np.save(tmp_path / "y.npy", photographs)
    np.save(tmp_path / "clip.npy", clip)
    (tmp_path / "folder").mkdir()
    codes = np.random.default_rng(0).integers(0, 256, (9, 4, 5, 3)).astype(np.uint8)
    for k, code in enumerate(codes):
        Image.fromarray(code).save(tmp_path / "folder" / f"{k}.png")
    bars = ps.read_hidden_image(ps.find_image("bars"), (4, 5))
    truth = {
        "clip.npy": clip,
        "folder": linear(codes),
        "bars": np.stack([bars] * 9),
    }[given]
    out = succeeds("video", "y.npy", *tiny, "--truth", given, "--out", "out")
    assert {path.name for path in (tmp_path / "out").iterdir()} == {
        *("frames", "frames.npy", "frames_sheet.png"),
        *("metrics.csv", "residual.png", "summary.json", "video.png"),
    }
    frames, summary, table = results(tmp_path / "out")
    errors = own_metrics(frames, truth)
    assert np.allclose(column(table, "mean_squared_error"), errors, rtol=1e-4)
    assert np.allclose(column(table, "psnr"), -10 * np.log10(errors), atol=1e-3)
    assert summary["median"]["psnr"] == pytest.approx(np.median(-10 * np.log10(errors)), abs=1e-3)
    assert summary["truth"] == given
    assert f"median gain-matched PSNR {summary['median']['psnr']:.2f} dB" in out
    shown, _ = animation(tmp_path / "out" / "video.png")
    for picture, wanted in zip(shown, truth, strict=True):
        assert np.allclose(linear(picture[34:274, 576:876][30::60, 30::60]), wanted, atol=0.006)
