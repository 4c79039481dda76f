"""Animated panels side by side under their titles: PNG, MP4 (H.264) and WebM (VP9).

Pillow keeps all frames of a PNG in memory (346 MB for 400 frames of 756 x 286 pixels); PyAV encodes
the others as they come.
"""

from __future__ import annotations

import json
from collections.abc import Iterable, Mapping, Sequence
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
from periscopy_sim.storage.pictures import area_average

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


def draw_animation(
    path: Path,
    titles: Sequence[str],
    frames: Iterable[Sequence[Image]],
    *,
    rate: float,
    metadata: Mapping[str, str] | None = None,
) -> None:
    """Draw linear images side by side as an animated PNG that repeats for ever.

    For each moment, `frames` gives a (rows, columns, 3) linear image in [0, 1] for each panel, of
    constant sizes. `rate` is in frames a second. Viewers without animation show the first frame.
    """
    from PIL import Image as Pillow
    from PIL.PngImagePlugin import PngInfo

    text = PngInfo()
    for name, value in (metadata or {}).items():
        text.add_itxt(name, value)
    first, *others = (Pillow.fromarray(side_by_side(titles, images)) for images in frames)
    with staged_file(path) as staged:
        first.save(
            staged, save_all=True, append_images=others, duration=1000 / rate, loop=0, pnginfo=text
        )


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
