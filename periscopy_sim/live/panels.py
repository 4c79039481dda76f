"""The panels of a laboratory: pictures with their captions and the scales of false colours."""

from base64 import b64encode
from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import cache
from io import BytesIO
from typing import Any

import numpy as np
from numpy.typing import NDArray
from PIL import Image

from periscopy_sim.figures.panels import common_white, encoded, residual_map
from periscopy_sim.figures.style import mpl
from periscopy_sim.live.pictures import LivePictures
from periscopy_sim.numerics import Array

Pixels = NDArray[np.uint8]
"""A picture, (rows, columns, 3 or 4) sRGB; the page hatches what is transparent."""


@dataclass(frozen=True, eq=False)
class Panel:
    """Pictures side by side, on one scale, and the text beneath them.

    `scale` is that of false colours: the name of matplotlib's colormap, and its ends as text.
    """

    caption: str
    pictures: Sequence[Pixels] = ()
    scale: tuple[str, str, str] | None = None

    def look(self) -> dict[str, Any]:
        """Return what `page.js` draws."""
        pictures = [{"source": as_source(p), "columns": p.shape[1]} for p in self.pictures]
        scale = None
        if self.scale is not None:
            name, low, high = self.scale
            stops = colours_of(name)[np.linspace(0, 255, 9).astype(int), :3]
            hexes = [f"#{bytes(each).hex()}" for each in stops]
            scale = {"colours": hexes, "low": low, "high": high}
        return {"caption": self.caption, "pictures": pictures, "scale": scale}


def as_source(pixels: Pixels) -> str:
    """Return a picture as the address of an image in a page."""
    file = BytesIO()
    Image.fromarray(pixels).save(file, "PNG", compress_level=1)  # of 30 a second
    return f"data:image/png;base64,{b64encode(file.getvalue()).decode()}"


def photograph_pixels(pictures: LivePictures) -> Pixels:
    """Return the photograph for display; masked pixels are transparent."""
    photograph = pictures.photograph
    used = photograph.pixels[..., np.newaxis]
    return _bytes(encoded(np.where(used, photograph.values, np.nan), None))


def hidden_pixels(pictures: LivePictures) -> dict[str, Pixels]:
    """Return images for display by surface; the reconstructions if they are unknown."""
    images = pictures.scenario.hidden.images(
        pictures.image if pictures.truth is None else pictures.truth
    )
    white = common_white(images.values()) if pictures.truth is None else 1.0
    return {name: _bytes(encoded(image, white)) for name, image in images.items()}


def _bytes(picture: Array) -> Pixels:
    return np.rint(255 * picture).astype(np.uint8)


def panels_of(pictures: LivePictures) -> list[Panel]:
    """Return the panels: photograph, reconstruction, and what is known of their errors.

    The frames of a stream have no standard errors, and no panel of them.
    """
    panels = [_photograph(pictures), _reconstruction(pictures), _third(pictures)]
    return panels if pictures.frame is not None else [*panels, _errors(pictures)]


def _photograph(pictures: LivePictures) -> Panel:
    choice, (rows, columns) = pictures.choice, pictures.photograph.shape
    lit = f", SBR {choice.sbr:g}" if choice.place else ""
    made = f"{lit}, {choice.snr:g} dB" if pictures.report.residual is None else ""
    return Panel(f"Photograph: {rows} x {columns} pixels{made}", [photograph_pixels(pictures)])


def _reconstruction(pictures: LivePictures) -> Panel:
    sizes = {n: "{} x {}".format(*shape) for n, shape in pictures.scenario.hidden.shapes.items()}
    each = sizes.values() if len(sizes) == 1 else map(" ".join, sizes.items())
    caption = f"Reconstruction: {', '.join(each)} patches"
    if pictures.psnr is not None:
        caption += f", PSNR {pictures.psnr:.1f} dB"
    return Panel(caption, [*hidden_pixels(replace(pictures, truth=None)).values()])


def _third(pictures: LivePictures) -> Panel:
    """Return the residual of a given photograph, or else the hidden image."""
    residual = pictures.report.residual
    if residual is None:
        shown = [] if pictures.truth is None else hidden_pixels(pictures).values()
        return Panel("Hidden image", [*shown])
    caption = f"Unexplained: {100 * residual.unexplained:.2f} %"
    if residual.noise_alone is not None:
        between = "alone" if pictures.frame is None else "between frames"
        caption += f", noise {between} {100 * residual.noise_alone:.2f} %"
    light, bound, unit = residual_map(residual)
    unit = unit.replace("standard deviations of noise", "σ of noise").partition(" of the")[0]
    scale = "RdBu_r", f"−{bound:.2g} {unit}", f"+{bound:.2g} {unit}"
    return Panel(caption, [_colours("RdBu_r", light / bound / 2 + 0.5)], scale)


def _errors(pictures: LivePictures) -> Panel:
    errors, hidden = pictures.report.standard_errors, pictures.scenario.hidden
    if errors is None:
        return Panel(f"Standard error: {pictures.choice.method} reports none")
    white = float(np.percentile(hidden.vector(pictures.image), 99)) or 1.0
    percent = 100 / white * np.sqrt(np.mean(hidden.vector(errors) ** 2, axis=1))
    counted = "noise and scene" if pictures.report.numbers.get("standard_errors_count") else "noise"
    median, largest = (float(f"{each(percent):.2g}") for each in (np.median, np.max))
    caption = f"Standard error ({counted}): median {median:g}, largest {largest:g} %"
    maps = hidden.split(percent / (percent.max() or 1.0)).values()
    scale = "magma", "0 %", f"{largest:g} % of white"
    return Panel(caption, [_colours("magma", each) for each in maps], scale)


def _colours(name: str, values: Array) -> Pixels:
    """Return false colours of values in [0, 1]; NaN is transparent."""
    levels = np.clip(256 * np.nan_to_num(values), 0, 255).astype(np.uint8)
    return colours_of(name)[levels] * np.isfinite(values)[..., np.newaxis].astype(np.uint8)


@cache
def colours_of(name: str) -> Pixels:
    """Return the 256 colours of matplotlib's colormap, with their opacity."""
    return _bytes(mpl.colormaps[name](np.arange(256)))
