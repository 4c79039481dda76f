"""Videos that every player plays, MP4 (H.264) and WebM (VP9), by PyAV."""

from __future__ import annotations

import json
from collections.abc import Iterable, Mapping, Sequence
from fractions import Fraction
from pathlib import Path
from typing import Any

import numpy as np

from periscopy_sim.errors import OutputError
from periscopy_sim.extras import require
from periscopy_sim.figures.animation import side_by_side
from periscopy_sim.figures.panels import Image
from periscopy_sim.storage.outputs.staging import staged_file

ENCODINGS = {
    "mp4": ("libx264", {"crf": "14", "preset": "medium"}),
    "webm": ("libvpx-vp9", {"crf": "20", "b": "0", "deadline": "good", "cpu-used": "4"}),
}
"""Encoder and its settings, which keep the patches' borders, by the ending of the file's name."""

BT709, SRGB = 1, 13
"""Primaries and matrix, and transfer, by their numbers in ITU-T H.273."""


def require_encoder(ending: str) -> None:
    """Raise a PeriscopyError unless this format can be written here."""
    if ending not in ENCODINGS:
        raise OutputError(f"no video format '{ending}'; use {' or '.join(ENCODINGS)}")
    av, encoder = require("av"), ENCODINGS[ending][0]
    try:
        av.codec.Codec(encoder, "w")
    except ValueError:  # PyAV's error of a missing encoder
        raise OutputError(
            f"PyAV {av.__version__} has no encoder {encoder}; install it from its wheel: "
            "pip install --force-reinstall --only-binary av av"
        ) from None


def draw_movie(
    path: Path,
    titles: Sequence[str],
    frames: Iterable[Sequence[Image]],
    *,
    rate: float,
    metadata: Mapping[str, str] | None = None,
) -> None:
    """Draw linear images side by side as a video, complete or not at all.

    Frames and titles are those of `draw_animation`, encoded as they come; `rate` is in frames a
    second. The path's ending, of `ENCODINGS`, sets the format; the metadata are a JSON comment. A
    PeriscopyError says that the format cannot be written here, a ValueError that there is no frame.
    """
    ending = path.suffix.removeprefix(".")
    require_encoder(ending)
    av: Any = require("av")
    stream = None
    reproducible = {"fflags": "+bitexact"}  # no random numbers of tracks
    with (
        staged_file(path) as staged,
        av.open(str(staged), "w", container_options=reproducible) as container,
    ):
        container.metadata["comment"] = json.dumps(dict(metadata or {}))
        for images in frames:
            picture = side_by_side(titles, images)
            rows, columns, _ = picture.shape  # even sides, as halved colours need: white is added
            margins = (0, rows % 2), (0, columns % 2), (0, 0)
            picture = np.pad(picture, margins, constant_values=255)
            if stream is None:
                stream = _stream(container, ending, picture.shape[:2], rate)
            frame = av.VideoFrame.from_ndarray(picture, format="rgb24").reformat(
                format="yuv420p", dst_colorspace=BT709, dst_color_range=BT709
            )
            container.mux(stream.encode(frame))
        if stream is None:
            raise ValueError("a video of no frames: give at least one")
        container.mux(stream.encode(None))


def _stream(container: Any, ending: str, size: tuple[int, ...], rate: float) -> Any:
    """Return the stream that pictures of a size are encoded to."""
    encoder, settings = ENCODINGS[ending]
    exact = Fraction(rate).limit_denominator(1000)
    stream = container.add_stream(encoder, exact, options=dict(settings))
    stream.height, stream.width = size
    stream.pix_fmt = "yuv420p"  # what every player takes
    context = stream.codec_context
    context.color_primaries = context.colorspace = BT709
    context.color_trc = SRGB
    context.thread_count = 1  # the same bytes on every machine
    return stream
