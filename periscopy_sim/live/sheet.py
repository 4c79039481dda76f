"""The pictures of a laboratory on one sheet of four tiles, and their captions."""

from typing import Any

import numpy as np
from numpy.typing import NDArray
from PIL import Image

from periscopy_sim.figures.panels import displayable, residual_map
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


def monitor_pixels(pictures: LivePictures) -> Pixels:
    """Return the hidden image for display, (R, C, 3); the reconstruction where it is unknown."""
    truth, image = pictures.truth, pictures.image
    return srgb_bytes(displayable(image) if truth is None else displayable(truth, white=1))


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
    caption = "Reconstruction: {} x {}".format(*pictures.image.shape[:2])
    if pictures.psnr is not None:
        caption += f", PSNR {pictures.psnr:.1f} dB"
    return caption, srgb_bytes(displayable(pictures.image))


def _third(pictures: LivePictures) -> Tile:
    """Return the residual of a given photograph, or else the hidden image."""
    residual = pictures.report.residual
    if residual is None:
        known = pictures.truth is not None
        return "Hidden image", monitor_pixels(pictures) if known else None
    caption = f"Unexplained: {100 * residual.unexplained:.2f} %"
    if residual.noise_alone is not None:
        caption += f", noise alone {100 * residual.noise_alone:.2f} %"
    light, bound, _ = residual_map(residual)
    return caption, _colours("RdBu_r", light / bound / 2 + 0.5)


def _errors(pictures: LivePictures) -> Tile:
    errors = pictures.report.standard_errors
    if errors is None:
        return f"Standard error: {pictures.choice.method} reports none", None
    white = float(np.percentile(pictures.image, 99)) or 1.0
    percent = 100 / white * np.sqrt(np.mean(errors**2, axis=2))
    caption = f"Standard error: median {np.median(percent):.2g}, largest {percent.max():.2g} %"
    return caption, _colours("magma", percent / (percent.max() or 1.0))


def _colours(name: str, values: Array) -> Pixels:
    """Return false colours of values in [0, 1]; NaN is grey."""
    colormap: Any = mpl.colormaps[name].with_extremes(bad="0.6")
    return np.ascontiguousarray(colormap(np.ma.masked_invalid(values), bytes=True)[..., :3])
