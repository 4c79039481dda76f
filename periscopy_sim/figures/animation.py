"""Pictures of videos: frames, sheets of them, and panels side by side in time.

Animations are PNG, MP4 (H.264) or WebM (VP9) files. Pillow keeps all frames of a PNG in memory (346
MB for 400 frames of 756 x 286 pixels); PyAV encodes the others as they come.
"""

import json
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from fractions import Fraction
from itertools import chain
from pathlib import Path
from typing import Any

import numpy as np

from periscopy_sim.errors import OutputError, require
from periscopy_sim.evaluation.metrics import gain_matched, mean_squared_error
from periscopy_sim.figures.panels import (
    Pixels,
    displayable,
    draw_panels,
    enlarged,
    exposed,
    write_enlarged,
)
from periscopy_sim.numerics import Image
from periscopy_sim.storage.outputs import staged_file
from periscopy_sim.storage.pictures import area_average

ENCODINGS = {
    "mp4": ("libx264", {"crf": "14", "preset": "medium"}),
    "webm": ("libvpx-vp9", {"crf": "20", "b": "0", "deadline": "good", "cpu-used": "4"}),
}
"""Encoder and its settings, which keep the patches' borders, by the ending of the file's name."""


def draw_animation(
    path: Path,
    titles: Sequence[str],
    frames: Iterable[Sequence[Image]],
    *,
    rate: float,
    metadata: Mapping[str, str] | None = None,
) -> None:
    """Draw linear images side by side in time, complete or not at all.

    For each moment, `frames` gives a (rows, columns, 3) linear image in [0, 1] for each panel, of
    constant sizes. `rate` is in frames a second. The path's ending sets the format: an animated PNG
    that repeats for ever, or one of `ENCODINGS`, whose metadata are a JSON comment.
    """
    pictures = (side_by_side(titles, images) for images in frames)
    write = _write_png if path.suffix == ".png" else _write_movie
    with staged_file(path) as staged:
        write(staged, pictures, rate, dict(metadata or {}))


def require_encoder(ending: str) -> None:
    """Raise a PeriscopyError unless this format of a video can be written here."""
    if ending not in ENCODINGS:
        raise OutputError(f"no video format '{ending}'; use {' or '.join(ENCODINGS)}")
    av, encoder = require("av"), ENCODINGS[ending][0]
    if encoder not in av.codecs_available:
        raise OutputError(f"PyAV has no encoder {encoder}; install its wheel: pip install av")


def _write_png(path: Path, pictures: Iterator[Pixels], rate: float, text: dict[str, str]) -> None:
    from PIL import Image as Pillow
    from PIL.PngImagePlugin import PngInfo

    chunks = PngInfo()
    for name, value in text.items():
        chunks.add_itxt(name, value)
    first, *others = map(Pillow.fromarray, pictures)
    more: dict[str, Any] = {"save_all": True, "append_images": others, "pnginfo": chunks}
    first.save(path, duration=1000 / rate, loop=0, **more)


def _write_movie(path: Path, pictures: Iterator[Pixels], rate: float, text: dict[str, str]) -> None:
    av: Any = require("av")
    encoder, settings = ENCODINGS[path.suffix.removeprefix(".")]
    first = next(pictures)
    rows, columns = (size // 2 * 2 for size in first.shape[:2])  # even, as halved colours need
    reproducible = {"fflags": "+bitexact"}  # no random numbers of tracks
    with av.open(str(path), "w", container_options=reproducible) as container:
        container.metadata["comment"] = json.dumps(text)
        stream = container.add_stream(
            encoder, Fraction(rate).limit_denominator(1000), options=dict(settings)
        )
        stream.height, stream.width, stream.pix_fmt = rows, columns, "yuv420p"
        context = stream.codec_context
        context.thread_count = 1  # the same bytes on every machine
        # BT.709's primaries and matrix, and sRGB's transfer, by their numbers in ITU-T H.273.
        context.color_primaries, context.colorspace, context.color_trc = 1, 1, 13
        for picture in chain([first], pictures):
            frame = av.VideoFrame.from_ndarray(
                np.ascontiguousarray(picture[:rows, :columns]), format="rgb24"
            )
            frame = frame.reformat(format="yuv420p", dst_colorspace=1, dst_color_range=1)
            container.mux(stream.encode(frame))
        container.mux(stream.encode(None))


def side_by_side(titles: Sequence[str], images: Sequence[Image]) -> Pixels:
    """Return a row of linear images on white, (rows, columns, 3), each centred under its title.

    The images are (rows, columns, 3) in [0, 1]; NaN is hatched.
    """
    from PIL import Image as Pillow
    from PIL import ImageDraw, ImageFont

    font, gap = ImageFont.load_default(22), 8
    panels = [Pillow.fromarray(_panel(image)) for image in images]
    widths = [
        max(p.width, int(np.ceil(font.getlength(t)))) for t, p in zip(titles, panels, strict=True)
    ]
    height = max(panel.height for panel in panels)
    shape = sum(widths) + 2 * gap * len(widths), height + 5 * gap
    sheet, left = Pillow.new("RGB", shape, "white"), gap
    draw = ImageDraw.Draw(sheet)
    for title, panel, width in zip(titles, panels, widths, strict=True):
        middle, top = left + width / 2, 4 * gap + (height - panel.height) // 2
        draw.text((middle, 2 * gap), title, "black", font, anchor="mm")
        sheet.paste(panel, (int(middle - panel.width / 2), top))
        left += width + 2 * gap
    return np.asarray(sheet)


def _panel(image: Image) -> Pixels:
    """Return 8-bit sRGB pixels of an image, its patches square.

    It has about 240 rows, and at most twice as many columns unless patches are smaller.
    """
    (rows, columns, _), height = image.shape, 240
    factor = max(1, min(round(height / rows), 2 * height // columns))
    if rows > 1.5 * height:
        image = area_average(image, (height, max(1, round(columns * height / rows))))
    return enlarged(image, factor, factor)


def evenly_spaced(count: int, most: int) -> list[int]:
    """Return at most so many of the numbers below `count`, the first and the last among them."""
    return [int(k) for k in np.linspace(0, count - 1, min(count, most)).round()]


def white_of(frames: Image) -> float:
    """Return one white for a whole sequence, whose brightness then does not flicker.

    It is the 99.5th percentile of up to 1000 frames, evenly chosen.
    """
    return float(np.nanpercentile(frames[evenly_spaced(len(frames), 1000)], 99.5))


def draw_frames(
    folder: Path,
    images: Image,
    white: float,
    text: dict[str, str],
    progress: Callable[[float], None],
) -> None:
    """Draw each frame as a picture of its own, 0000.png and so on, with one white for all."""
    folder.mkdir()
    digits = max(4, len(str(len(images) - 1)))
    for k, image in enumerate(images):
        write_enlarged(folder / f"{k:0{digits}}.png", displayable(image, white), text)
        progress((k + 1) / len(images))


def draw_sheet(
    path: Path,
    photographs: Image,
    known: Mapping[str, Image],
    images: Mapping[str, Image],
    text: dict[str, str],
) -> None:
    """Draw hidden images, photograph and gain-matched images of 8 frames evenly chosen (Fig. 7).

    The images are by the surfaces' ids; their mean squared errors stand above.
    """
    chosen = evenly_spaced(len(photographs), 8)
    white = white_of(photographs)
    of = {name: f"\n{name}" if len(known) > 1 else "" for name in known}
    rows = {
        f"hidden image{of[name]}": [("", displayable(truth[k], 1)) for k in chosen]
        for name, truth in known.items()
    }
    rows["photograph"] = [("", exposed(photographs[k], white)) for k in chosen]
    for name, truth in known.items():
        rows[f"reconstruction{of[name]}"] = [
            (
                f"MSE {mean_squared_error(images[name][k], truth[k]):.2g}",
                displayable(gain_matched(images[name][k], truth[k]), 1),
            )
            for k in chosen
        ]
    first = next(iter(rows))
    rows[first] = [(f"frame {k}", image) for k, (_, image) in zip(chosen, rows[first], strict=True)]
    draw_panels(path, rows, metadata=text)


def draw_video(
    path: Path,
    photographs: Image,
    images: Mapping[str, Image],
    known: Mapping[str, Image],
    white: float,
    rate: float,
    text: dict[str, str],
    progress: Callable[[float], None],
) -> None:
    """Draw hidden images, where they are known, photograph and reconstructions, side by side.

    Images are by the surfaces' ids. The path's ending sets the format, see `draw_animation`.
    """
    of = {name: f" of {name}" if len(images) > 1 else "" for name in images}
    panels = {f"hidden image{of[name]}": (truth, 1.0) for name, truth in known.items()}
    panels["photograph"] = photographs, white_of(photographs)
    panels |= {f"reconstruction{of[name]}": (stack, white) for name, stack in images.items()}

    def moments() -> Iterator[list[Image]]:
        for k in range(len(photographs)):
            yield [exposed(shown[k], level) for shown, level in panels.values()]
            progress((k + 1) / len(photographs))

    draw_animation(path, list(panels), moments(), rate=rate, metadata=text)
