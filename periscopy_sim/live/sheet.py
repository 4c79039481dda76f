"""The pictures of a laboratory on one sheet of four tiles, and their captions."""

from collections.abc import Iterable
from dataclasses import replace
from typing import Any

import numpy as np
from numpy.typing import NDArray
from PIL import Image

from periscopy_sim.figures.panels import common_white, displayable, residual_map
from periscopy_sim.figures.style import mpl
from periscopy_sim.live.pictures import LivePictures
from periscopy_sim.numerics import Array
from periscopy_sim.storage.formats.srgb import srgb_bytes

Pixels = NDArray[np.uint8]
Tile = tuple[str, Pixels | None]


def photograph_pixels(pictures: LivePictures) -> Pixels:
    """Return the photograph for display, (rows, columns, 3), grey where the mask excludes it."""
    photograph = pictures.photograph
    shown = srgb_bytes(displayable(photograph.values))
    if photograph.mask is not None:
        shown[~photograph.mask] = 150
    return shown


def hidden_pixels(pictures: LivePictures) -> dict[str, Pixels]:
    """Return images for display, (R, C, 3), by surface; the reconstructions if they are unknown."""
    images = pictures.scenario.hidden.images(
        pictures.image if pictures.truth is None else pictures.truth
    )
    white = common_white(images.values()) if pictures.truth is None else 1.0
    return {name: srgb_bytes(displayable(image, white)) for name, image in images.items()}


def _side_by_side(images: Iterable[Pixels]) -> Pixels:
    """Return images of several surfaces as one, on white, a column apart."""
    shown = list(images)
    rows = max(each.shape[0] for each in shown)
    columns = []
    for each in shown:
        above, right = rows - each.shape[0], int(each is not shown[-1])
        padding = (above, 0), (0, right), (0, 0)
        columns.append(np.pad(each, padding, constant_values=255))
    return np.concatenate(columns, axis=1)


def draw_sheet(pictures: LivePictures, side: int = 348, gap: int = 16) -> tuple[Pixels, list[str]]:
    """Return the sheet, (rows, columns, 3), and the captions of its tiles, row by row.

    Tiles have a longest side of `side` pixels, and `gap` pixels between them.
    """
    tiles = [_photograph(pictures), _reconstruction(pictures), _third(pictures), _errors(pictures)]
    pitch = side + gap
    sheet = Image.new("RGB", (pitch + side, pitch + side), "white")
    for k, (_, pixels) in enumerate(tiles):
        if pixels is not None:
            rows, columns = (max(1, side * n // max(pixels.shape[:2])) for n in pixels.shape[:2])
            tile = Image.fromarray(pixels).resize((columns, rows), Image.Resampling.NEAREST)
            sheet.paste(tile, (k % 2 * pitch, k // 2 * pitch + side - rows))
    return np.asarray(sheet), [caption for caption, _ in tiles]


def _photograph(pictures: LivePictures) -> Tile:
    choice, (rows, columns) = pictures.choice, pictures.photograph.shape
    lit = f", SBR {choice.sbr:g}" if choice.place else ""
    made = f"{lit}, {choice.snr:g} dB" if pictures.report.residual is None else ""
    return f"Photograph: {rows} x {columns}{made}", photograph_pixels(pictures)


def _reconstruction(pictures: LivePictures) -> Tile:
    hidden = pictures.scenario.hidden
    sizes = {name: "{} x {}".format(*size) for name, size in hidden.shapes.items()}
    each = [f"{name} {size}" for name, size in sizes.items()]
    caption = f"Reconstruction: {', '.join(each if len(each) > 1 else sizes.values())}"
    if pictures.psnr is not None:
        caption += f", PSNR {pictures.psnr:.1f} dB"
    shown = hidden_pixels(replace(pictures, truth=None))
    return caption, _side_by_side(shown.values())


def _third(pictures: LivePictures) -> Tile:
    """Return the residual of a given photograph, or else the hidden image."""
    residual = pictures.report.residual
    if residual is None:
        known = pictures.truth is not None
        return "Hidden image", _side_by_side(hidden_pixels(pictures).values()) if known else None
    caption = f"Unexplained: {100 * residual.unexplained:.2f} %"
    if residual.noise_alone is not None:
        caption += f", noise alone {100 * residual.noise_alone:.2f} %"
    light, bound, _ = residual_map(residual)
    return caption, _colours("RdBu_r", light / bound / 2 + 0.5)


def _errors(pictures: LivePictures) -> Tile:
    errors, hidden = pictures.report.standard_errors, pictures.scenario.hidden
    if errors is None:
        return f"Standard error: {pictures.choice.method} reports none", None
    white = float(np.percentile(hidden.vector(pictures.image), 99)) or 1.0
    percent = 100 / white * np.sqrt(np.mean(hidden.vector(errors) ** 2, axis=1))
    caption = f"Standard error: median {np.median(percent):.2g}, largest {percent.max():.2g} %"
    shown = hidden.split(percent / (percent.max() or 1.0))
    return caption, _side_by_side(_colours("magma", each) for each in shown.values())


def _colours(name: str, values: Array) -> Pixels:
    """Return false colours of values in [0, 1]; NaN is grey."""
    colormap: Any = mpl.colormaps[name].with_extremes(bad="0.6")
    return np.ascontiguousarray(colormap(np.ma.masked_invalid(values), bytes=True)[..., :3])
