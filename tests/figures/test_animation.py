import json

import numpy as np
import pytest
from PIL import Image, ImageSequence

from periscopy_sim.errors import PeriscopyError
from periscopy_sim.figures import animation
from periscopy_sim.storage.rasters import srgb_bytes
from tests.scenes.pictures import box, covers

METADATA = {"command": "periscopy video λ", "seed": "3"}
# Linear 0.21404 is 0.5 in sRGB, 0.05127 is 0.25.
COLOURS = np.array([[0.21404, 1, 0], [0, 0.05127, 1], [1, 0, 0.21404]])
CODES = np.array([[127.5, 255, 0], [0, 63.8, 255], [255, 0, 127.5]])


def plain(colour, shape=(4, 5)):
    return np.broadcast_to(colour, (*shape, 3))


def draw(path, frames, rate=16.0, titles=("left", "right")):
    animation.draw_animation(path, titles, frames, rate=rate, metadata=METADATA)
    with Image.open(path) as picture:
        shown = [
            (frame.info.get("duration"), np.asarray(frame.convert("RGB")).astype(int))
            for frame in ImageSequence.Iterator(picture)
        ]
        return [pixels for _, pixels in shown], [duration for duration, _ in shown], picture


@pytest.fixture
def moments():
    """Three moments of two panels of different shapes, their colours in turn."""
    return [[plain(COLOURS[k]), plain(COLOURS[(k + 1) % 3], (12, 12))] for k in range(3)]


def test_each_frame_shows_its_panels_side_by_side_in_srgb(moments, tmp_path):
    shown, _, _ = draw(tmp_path / "a.png", moments)
    assert len(shown) == 3
    for k, pixels in enumerate(shown):
        top, bottom, left, right = box(covers(pixels, CODES[k]))
        assert (bottom - top + 1, right - left + 1) == (240, 300)
        others = box(covers(pixels, CODES[(k + 1) % 3]))
        assert (others[1] - others[0] + 1, others[3] - others[2] + 1) == (240, 240)
        assert right < others[2] and (pixels[bottom + 1 :] == 255).all()
        assert (pixels[:top].min(axis=2) < 100).any()  # the titles


def test_panel_of_any_shape_is_legible(tmp_path):
    for shape, size in [
        ((126, 126), (252, 252)),
        ((1008, 504), (240, 120)),
        ((1, 400), (1, 400)),
        ((1, 1), (240, 240)),
    ]:
        shown, _, _ = draw(tmp_path / "a.png", [[plain(COLOURS[0], shape)]], titles=["t"])
        top, bottom, left, right = box(covers(shown[0], CODES[0]))
        assert (bottom - top + 1, right - left + 1) == size


def test_frames_last_as_the_rate_asks_and_repeat_for_ever(moments, tmp_path):
    for rate in [0.1, 16, 24, 29.97, 1000]:
        _, durations, picture = draw(tmp_path / "a.png", moments, rate)
        assert durations == pytest.approx([1000 / rate] * 3, abs=0.6)
        assert picture.info["loop"] == 0 and METADATA.items() <= picture.info.items()


av = pytest.importorskip("av")


@pytest.mark.usefixtures("drawings")
def test_sheet_has_hidden_images_above_reconstructions_and_frames_in_order(tmp_path):
    truth = np.array([plain(0.8 * colour) for colour in COLOURS])
    animation.draw_sheet(
        tmp_path / "sheet.png", 0 * truth + 0.5, {"m": truth}, {"m": 2 * truth}, METADATA
    )
    with Image.open(tmp_path / "sheet.png") as picture:
        pixels, text = np.asarray(picture.convert("RGB")).astype(int), dict(picture.text)
    assert METADATA.items() <= text.items()
    middles = []
    for colour in srgb_bytes(0.8 * COLOURS).astype(int):
        rows, columns = np.nonzero((np.abs(pixels - colour) < 3).all(axis=2))
        (gap,) = np.nonzero(np.diff(np.unique(rows)) > 50)  # the photograph's row
        assert len(gap) == 1
        middles.append(columns.mean())
    assert np.all(np.diff(middles) > 100)


def frames(count, size=(7, 9)):
    rng = np.random.default_rng(3)
    return [[rng.uniform(0, 1, (*size, 3)), np.full((*size, 3), k / count)] for k in range(count)]


@pytest.mark.parametrize("ending", animation.ENCODINGS)
def test_video_shows_every_frame_at_its_time_in_its_colours(ending, tmp_path):
    path, drawn = tmp_path / f"video.{ending}", frames(10)
    animation.draw_animation(path, ["one", "two"], drawn, rate=12.5, metadata={"seed": "3"})
    with av.open(str(path)) as container:
        (stream,) = container.streams.video
        assert float(stream.average_rate) == pytest.approx(12.5)
        assert json.loads(container.metadata.get("comment") or container.metadata["COMMENT"]) == {
            "seed": "3"
        }
        decoded = list(container.decode(stream))
    times = [k / 12.5 for k in range(10)]
    assert [float(frame.time) for frame in decoded] == pytest.approx(times, abs=2e-3)
    assert {frame.format.name for frame in decoded} == {"yuv420p"}
    for frame, images in zip(decoded, drawn, strict=True):
        shown = frame.to_ndarray(format="rgb24").astype(float)
        rows, columns, _ = shown.shape
        difference = shown - animation.side_by_side(["one", "two"], images)[:rows, :columns]
        assert abs(difference.mean(axis=(0, 1))).max() < 2
        assert np.median(abs(difference)) < 4


def test_video_that_fails_leaves_nothing(tmp_path):
    def broken():
        yield from frames(3)
        raise RuntimeError("no more")

    with pytest.raises(RuntimeError, match="no more"):
        animation.draw_animation(tmp_path / "video.mp4", ["x", "y"], broken(), rate=16)
    assert not list(tmp_path.iterdir())


def test_what_cannot_be_encoded_is_refused(monkeypatch):
    with pytest.raises(PeriscopyError, match="'gif'"):
        animation.require_encoder("gif")
    monkeypatch.setitem(animation.ENCODINGS, "mp4", ("libnone", {}))
    with pytest.raises(PeriscopyError, match="has no encoder libnone"):
        animation.require_encoder("mp4")
