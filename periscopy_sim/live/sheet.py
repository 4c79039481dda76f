"""The pictures of a laboratory on one sheet, quickly: four tiles, each with a line about it."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from periscopy_sim.figures.panels import displayable
from periscopy_sim.figures.residual import residual_map
from periscopy_sim.live.level import LivePictures
from periscopy_sim.scenario import Array
from periscopy_sim.storage.formats.srgb import srgb_bytes

if TYPE_CHECKING:
    from PIL.ImageDraw import ImageDraw

Pixels = NDArray[np.uint8]

TILE = 348, 300
"""Width and height of a tile, in pixels."""

LINE = 62
"""Height of what is written above a tile: two lines."""

GAP = 16
PAPER, INK, PALE = (255, 255, 255), (33, 37, 41), (120, 128, 136)


def photograph_pixels(pictures: LivePictures) -> Pixels:
    """Return the photograph for display, (rows, columns, 3), grey where it is not used."""
    shown = srgb_bytes(displayable(pictures.photograph))
    if pictures.used is not None:
        shown[~pictures.used] = 150
    return shown


def monitor_pixels(pictures: LivePictures) -> Pixels:
    """Return what the monitor shows, (R, C, 3); the reconstruction where nobody knows."""
    if pictures.truth is not None:
        return srgb_bytes(displayable(pictures.truth, white=1))
    return srgb_bytes(displayable(pictures.image))


def draw_sheet(pictures: LivePictures) -> Pixels:
    """Return the sheet, (rows, columns, 3)."""
    from PIL import Image, ImageDraw

    tiles = [_photograph(pictures), _reconstruction(pictures), _second(pictures), _errors(pictures)]
    width, height = TILE
    sheet = Image.new("RGB", (2 * (width + GAP), 2 * (height + LINE) + GAP), PAPER)
    draw = ImageDraw.Draw(sheet)
    for k, (title, note, pixels) in enumerate(tiles):
        row, column = divmod(k, 2)
        x, y = column * (width + GAP), row * (height + LINE + GAP)
        _write(draw, x, y, title, note)
        if pixels is None:
            continue
        rows, columns = pixels.shape[:2]
        scale = min(width / columns, height / rows)
        size = max(1, round(columns * scale)), max(1, round(rows * scale))
        tile = Image.fromarray(pixels).resize(size, Image.Resampling.NEAREST)
        sheet.paste(tile, (x, y + LINE))
    return np.asarray(sheet)


def _write(draw: ImageDraw, x: int, y: int, title: str, note: str) -> None:
    from PIL import ImageFont

    draw.text((x, y), title, INK, font=ImageFont.load_default(25))
    draw.text((x, y + 31), note, PALE, font=ImageFont.load_default(21))


Tile = tuple[str, str, Pixels | None]


def _photograph(pictures: LivePictures) -> Tile:
    rows, columns = pictures.photograph.shape[:2]
    choice = pictures.choice
    told = f"{rows} x {columns}"
    if pictures.residual is None:
        if choice.place:
            told += ", light comes" if pictures.is_dark else f", SBR {choice.sbr:g}"
        told += f", {choice.snr:g} dB"
    return "Photograph", told, photograph_pixels(pictures)


def _reconstruction(pictures: LivePictures) -> Tile:
    R, C = pictures.image.shape[:2]
    told = f"{R} x {C}" + (", coarse" if pictures.is_coarse else "")
    if pictures.psnr is not None:
        told += f", PSNR {pictures.psnr:.1f} dB"
    return "Reconstruction", told, srgb_bytes(displayable(pictures.image))


def _second(pictures: LivePictures) -> Tile:
    """Return what the scene leaves of a given photograph, or else what was hidden."""
    left = pictures.residual
    if left is None:
        if pictures.truth is None:
            return "Hidden image", "not known", None
        return "Hidden image", "what the monitor shows", monitor_pixels(pictures)
    told = f"{100 * left.unexplained:.2f} %"
    if left.noise_alone is not None:
        told += f", noise alone {100 * left.noise_alone:.2f} %"
    light, bound, _ = residual_map(left)
    return "Unexplained", told, _colours("RdBu_r", light / bound / 2 + 0.5)


def _errors(pictures: LivePictures) -> Tile:
    errors = pictures.standard_errors
    if errors is None:
        return "Standard error", f"{pictures.choice.method} tells none", None
    white = float(np.percentile(pictures.image, 99)) or 1.0
    percent = 100 / white * np.sqrt(np.mean(errors**2, axis=2))
    top = float(percent.max()) or 1.0
    middle = float(np.median(percent))
    told = f"median {middle:.2g}, largest {top:.2g} % of white"
    return "Standard error", told, _colours("magma", percent / top)


def _colours(name: str, values: Array) -> Pixels:
    """Return false colours of values in [0, 1]; NaN is grey."""
    from matplotlib import colormaps

    found: Any = colormaps[name].with_extremes(bad="0.6")(np.ma.masked_invalid(values), bytes=True)
    return np.ascontiguousarray(found[..., :3])
