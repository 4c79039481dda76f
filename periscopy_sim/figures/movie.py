"""Videos that every player plays, MP4 (H.264) and WebM (VP9), by PyAV."""

from __future__ import annotations

import json
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass
from fractions import Fraction
from pathlib import Path
from typing import Any

import numpy as np

from periscopy_sim.errors import OutputError
from periscopy_sim.extras import require
from periscopy_sim.figures.animation import Pixels, side_by_side
from periscopy_sim.figures.panels import Image
from periscopy_sim.storage.outputs.staging import staged_file


@dataclass(frozen=True)
class Encoding:
    """An encoder by its name, and its settings: patches keep their borders."""

    encoder: str
    settings: Mapping[str, str]


ENCODINGS = {
    "mp4": Encoding("libx264", {"crf": "14", "preset": "medium"}),
    "webm": Encoding("libvpx-vp9", {"crf": "20", "b": "0", "deadline": "good", "cpu-used": "4"}),
}
"""What each format is encoded by, by the ending of the file's name."""

BT709, SRGB = 1, 13
"""Primaries and matrix, and transfer, by their numbers in ITU-T H.273."""


def require_encoder(ending: str) -> None:
    """Refuse a format that cannot be written here, by a PeriscopyError that says what to do."""
    if ending not in ENCODINGS:
        raise OutputError(f"no video format '{ending}'; use {' or '.join(ENCODINGS)}")
    av, encoder = require("av"), ENCODINGS[ending].encoder
    try:
        av.codec.Codec(encoder, "w")
    except ValueError:  # so PyAV tells it
        raise OutputError(
            f"PyAV {av.__version__} has no encoder {encoder} here, as {ending} needs; install it "
            "anew from its wheel: pip install --force-reinstall --only-binary av av"
        ) from None


def draw_movie(
    path: Path,
    titles: Sequence[str],
    frames: Iterable[Sequence[Image]],
    *,
    rate: float,
    metadata: Mapping[str, str] | None = None,
) -> None:
    """Draw linear images side by side as a video, one that appears complete or not at all.

    Frames and titles are those of `draw_animation`, encoded as they come; `rate` is in frames a
    second. The path's ending, of `ENCODINGS`, tells the format; the metadata are a JSON comment.

    Raises
    ------
    PeriscopyError
        As `require_encoder`.
    ValueError
        If there is no frame.
    """
    ending = path.suffix.removeprefix(".")
    require_encoder(ending)
    av: Any = require("av")
    encoding = ENCODINGS[ending]
    stream = None
    with (
        staged_file(path) as staged,
        av.open(
            str(staged),
            "w",
            container_options={"fflags": "+bitexact"},  # no random numbers of tracks
        ) as container,
    ):
        container.metadata["comment"] = json.dumps(dict(metadata or {}))
        for images in frames:
            picture = _even(side_by_side(titles, images))
            if stream is None:
                stream = _stream(container, encoding, picture, rate)
            frame = av.VideoFrame.from_ndarray(picture, format="rgb24").reformat(
                format="yuv420p", dst_colorspace=BT709, dst_color_range=BT709
            )
            container.mux(stream.encode(frame))
        if stream is None:
            raise ValueError("a video of no frames: give at least one")
        container.mux(stream.encode(None))


def _stream(container: Any, encoding: Encoding, picture: Pixels, rate: float) -> Any:
    """Return the stream that pictures of a size are encoded to."""
    exact = Fraction(rate).limit_denominator(1000)
    stream = container.add_stream(encoding.encoder, exact, options=dict(encoding.settings))
    stream.height, stream.width, _ = picture.shape
    stream.pix_fmt = "yuv420p"  # what every player takes
    context = stream.codec_context
    context.color_primaries = context.colorspace = BT709
    context.color_trc = SRGB
    context.thread_count = 1  # the same bytes on every machine
    return stream


def _even(picture: Pixels) -> Pixels:
    """Return a picture with even sides, as halved colours need: white is added."""
    rows, columns, _ = picture.shape
    sides = (0, rows % 2), (0, columns % 2), (0, 0)
    return np.pad(picture, sides, constant_values=255)
