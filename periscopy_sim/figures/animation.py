"""Animated panels side by side under their titles: PNG, MP4 (H.264) and WebM (VP9).

Pillow would draw each frame of a PNG twice, keep all of them in memory (346 MB for 400 frames of
756 x 286 pixels) and merge equal ones, so the chunks are put together here. PyAV writes the others.
"""

from __future__ import annotations

import json
import struct
import zlib
from collections.abc import Iterable, Iterator, Mapping, Sequence
from fractions import Fraction
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from periscopy_sim.errors import OutputError
from periscopy_sim.extras import require
from periscopy_sim.figures.panels import Image
from periscopy_sim.storage.formats.srgb import srgb_bytes
from periscopy_sim.storage.outputs.staging import staged_file
from periscopy_sim.storage.pictures import area_average, png_bytes

Pixels = NDArray[np.uint8]

PANEL = (240, 480)
"""Rows that a panel has about, and columns that it has at most, unless patches are smaller."""

MARGINS = {"title": 34, "gap": 12}
"""Pixels above the panels, and between and below them."""

ENCODINGS = {
    "mp4": ("libx264", {"crf": "14", "preset": "medium"}),
    "webm": ("libvpx-vp9", {"crf": "20", "b": "0", "deadline": "good", "cpu-used": "4"}),
}
"""Encoder and its settings, which keep the patches' borders, by the ending of the file's name."""

COLOURS = {"color_primaries": 1, "colorspace": 1, "color_trc": 13}
"""BT.709's primaries and matrix, and sRGB's transfer, by their numbers in ITU-T H.273."""

_SIGNATURE = b"\x89PNG\r\n\x1a\n"


def draw_animation(
    path: Path,
    titles: Sequence[str],
    frames: Iterable[Sequence[Image]],
    *,
    count: int,
    rate: float,
    metadata: Mapping[str, str] | None = None,
) -> None:
    """Draw linear images side by side as an animated PNG that repeats for ever.

    For each of `count` moments, `frames` gives a (rows, columns, 3) linear image in [0, 1] for
    each panel, of constant sizes. Frames are drawn and encoded one at a time, so that a long video
    takes no more memory than a short one. `rate` is in frames a second. Viewers without animation
    show the first frame. A ValueError says that there are more or fewer frames than `count`.

    References
    ----------
    Portable Network Graphics (PNG) Specification, third edition, W3C 2025: chunks acTL, fcTL, fdAT.
    """
    delay = Fraction(1 / rate).limit_denominator(10_000)
    number = -1
    with staged_file(path) as staged, staged.open("wb") as stream:

        def write(kind: bytes, content: bytes) -> None:
            stream.write(struct.pack(">I", len(content)) + kind + content)
            stream.write(struct.pack(">I", zlib.crc32(kind + content)))

        stream.write(_SIGNATURE)
        for number, frame in enumerate(frames):
            picture = side_by_side(titles, frame)
            chunks = list(_chunks(png_bytes(picture, {} if number else metadata or {})))
            data = b"".join(content for kind, content in chunks if kind == b"IDAT")
            if number == 0:
                for kind, content in chunks:
                    if kind not in (b"IDAT", b"IEND"):
                        write(kind, content)
                write(b"acTL", struct.pack(">2I", count, 0))  # 0: for ever
            # Control and data chunks are numbered in turn; the first picture's data bear no number.
            place = (max(2 * number - 1, 0), picture.shape[1], picture.shape[0], 0, 0)
            timing = (delay.numerator, delay.denominator, 0, 0)
            write(b"fcTL", struct.pack(">5I2H2B", *place, *timing))
            write(*((b"fdAT", struct.pack(">I", 2 * number) + data) if number else (b"IDAT", data)))
        if number + 1 != count:
            raise ValueError(f"got {number + 1} frames, not {count}")
        write(b"IEND", b"")


def _chunks(file: bytes) -> Iterator[tuple[bytes, bytes]]:
    """Yield kinds and contents of the chunks of a PNG file."""
    start = len(_SIGNATURE)
    while start < len(file):
        (length,) = struct.unpack_from(">I", file, start)
        yield file[start + 4 : start + 8], file[start + 8 : start + 8 + length]
        start += length + 12


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
                format="yuv420p", dst_colorspace=COLOURS["colorspace"], dst_color_range=1
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
    for name, number in COLOURS.items():
        setattr(stream.codec_context, name, number)
    stream.codec_context.thread_count = 1  # the same bytes on every machine
    return stream


def _panel(image: Image) -> Pixels:
    """Return 8-bit sRGB pixels of an image at about a panel's size, its patches square."""
    rows, columns, _ = image.shape
    factor = max(1, min(round(PANEL[0] / rows), PANEL[1] // columns))
    if rows > 1.5 * PANEL[0]:
        image = area_average(image, (PANEL[0], max(1, round(columns * PANEL[0] / rows))))
    encoded = srgb_bytes(image)
    return np.repeat(np.repeat(encoded, factor, axis=0), factor, axis=1)


def side_by_side(titles: Sequence[str], images: Sequence[Image]) -> Pixels:
    """Return panels of linear images on white, (rows, columns, 3), each centred under its title.

    Columns hold both. The images are (rows, columns, 3) in [0, 1].
    """
    from PIL import Image as Pillow
    from PIL import ImageDraw, ImageFont

    font = ImageFont.load_default(20)
    panels = [_panel(image) for image in images]
    widths = [
        max(panel.shape[1], int(np.ceil(font.getlength(title))))
        for title, panel in zip(titles, panels, strict=True)
    ]
    top, gap = MARGINS["title"], MARGINS["gap"]
    rows = max(panel.shape[0] for panel in panels)
    picture = Pillow.new("RGB", (sum(widths) + gap * (len(widths) + 1), top + rows + gap), "white")
    draw = ImageDraw.Draw(picture)
    left = gap
    for title, panel, width in zip(titles, panels, widths, strict=True):
        draw.text((left + width / 2, top / 2), title, "black", font, anchor="mm")
        corner = (left + (width - panel.shape[1]) // 2, top + (rows - panel.shape[0]) // 2)
        picture.paste(Pillow.fromarray(panel), corner)
        left += width + gap
    return np.asarray(picture)
