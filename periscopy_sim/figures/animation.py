"""Animated PNG: panels side by side under their titles, in time.

Pillow would draw each frame twice, keep all of them in memory (346 MB for 400 frames of 756 x 286
pixels) and merge equal ones, so the chunks are put together here.
"""

from __future__ import annotations

import struct
import zlib
from collections.abc import Iterable, Iterator, Mapping, Sequence
from fractions import Fraction
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from periscopy_sim.figures.panels import Image
from periscopy_sim.storage.formats.srgb import srgb_bytes
from periscopy_sim.storage.outputs.staging import staged_file
from periscopy_sim.storage.pictures import area_average, png_bytes

Pixels = NDArray[np.uint8]

PANEL = (240, 480)
"""Rows that a panel has about, and columns that it has at most, unless patches are smaller."""

_TITLE_ROWS, _GAP = 34, 12
_FONT = "fonts/ttf/DejaVuSans.ttf"  # Matplotlib's own: the same on every machine
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
    import matplotlib
    from PIL import Image as Pillow
    from PIL import ImageDraw, ImageFont

    font = ImageFont.truetype(Path(matplotlib.get_data_path(), _FONT), 20)
    panels = [_panel(image) for image in images]
    widths = [
        max(panel.shape[1], int(np.ceil(font.getlength(title))))
        for title, panel in zip(titles, panels, strict=True)
    ]
    rows = max(panel.shape[0] for panel in panels)
    size = (sum(widths) + _GAP * (len(widths) + 1), _TITLE_ROWS + rows + _GAP)
    picture = Pillow.new("RGB", size, "white")
    draw = ImageDraw.Draw(picture)
    left = _GAP
    for title, panel, width in zip(titles, panels, widths, strict=True):
        draw.text((left + width / 2, _TITLE_ROWS / 2), title, "black", font, anchor="mm")
        corner = (left + (width - panel.shape[1]) // 2, _TITLE_ROWS + (rows - panel.shape[0]) // 2)
        picture.paste(Pillow.fromarray(panel), corner)
        left += width + _GAP
    return np.asarray(picture)
