import json

import numpy as np
import pytest

from periscopy_sim.errors import PeriscopyError
from periscopy_sim.figures.animation import (
    ENCODINGS,
    draw_animation,
    require_encoder,
    side_by_side,
)

av = pytest.importorskip("av")


def frames(count, size=(7, 9)):
    rng = np.random.default_rng(3)
    return [[rng.uniform(0, 1, (*size, 3)), np.full((*size, 3), k / count)] for k in range(count)]


@pytest.mark.parametrize("ending", ENCODINGS)
def test_video_shows_every_frame_at_its_time_in_its_colours(ending, tmp_path):
    path, drawn = tmp_path / f"video.{ending}", frames(10)
    draw_animation(path, ["one", "two"], drawn, rate=12.5, metadata={"seed": "3"})
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
        difference = shown - side_by_side(["one", "two"], images)[:rows, :columns]
        assert abs(difference.mean(axis=(0, 1))).max() < 2
        assert np.median(abs(difference)) < 4


def test_video_that_fails_leaves_nothing(tmp_path):
    def broken():
        yield from frames(3)
        raise RuntimeError("no more")

    with pytest.raises(RuntimeError, match="no more"):
        draw_animation(tmp_path / "video.mp4", ["x", "y"], broken(), rate=16)
    assert not list(tmp_path.iterdir())


def test_what_cannot_be_encoded_is_refused(monkeypatch):
    with pytest.raises(PeriscopyError, match="'gif'"):
        require_encoder("gif")
    monkeypatch.setitem(ENCODINGS, "mp4", ("libnone", {}))
    with pytest.raises(PeriscopyError, match="has no encoder libnone"):
        require_encoder("mp4")
