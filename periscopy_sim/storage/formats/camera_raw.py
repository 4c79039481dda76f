"""Raw files of cameras, read by LibRaw: the sensor's counts, linear, colours as measured.

Each 2 x 2 cell of the Bayer mosaic becomes one pixel: its red, its blue and the mean of its two
greens. Nothing is interpolated, as demosaicing would, so noise stays white; there is no white
balance, no colour matrix and no gamma.
"""

from __future__ import annotations

from collections.abc import Sequence
from contextlib import suppress
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from periscopy_sim.errors import PhotographError
from periscopy_sim.storage.formats.decoding import Picture, decoding
from periscopy_sim.storage.formats.rasters import reaches_its_pixels

RAW_SUFFIXES = (
    ".dng", ".nef", ".nrw", ".arw", ".srf", ".sr2", ".cr2", ".cr3", ".pef", ".raf", ".orf", ".rw2",
    ".srw", ".3fr", ".erf", ".iiq", ".mef", ".mos", ".kdc", ".dcr", ".rwl",
)  # fmt: skip

RAW_SIGNATURE = rb"II\*\x00|MM\x00\*|.{4}ftypcrx |FUJIFILMCCD-RAW|IIRO|IIRS|MMOR|IIU\x00"
"""Mostly TIFF's; the others are Canon's CR3, Fujifilm's, Olympus', and Panasonic's."""


def read_camera_raw(path: Path, *_: object) -> Picture:
    """Read a camera's raw file as counts above its black level, half the mosaic's size."""
    import rawpy  # outside `decoding`: a missing package is no damaged file
    import tifffile

    is_whole = True
    with suppress(Exception), tifffile.TiffFile(path) as file:
        is_whole = reaches_its_pixels(file, path)
    with decoding(path, "camera raw"), rawpy.imread(str(path)) as raw:
        if not is_whole:  # LibRaw would fill what is cut off
            raise ValueError("it is cut short")
        counts, flip = raw.raw_image_visible.astype(np.float32), raw.sizes.flip
        full = counts >= raw.white_level
        black = np.array(raw.black_level_per_channel, np.float32)
        if raw.num_colors == 1:
            light = (counts - black[0])[..., np.newaxis]
            return Picture(_upright(light, flip), saturated=_upright(full, flip))
        colours = raw.raw_colors_visible
        places = [chr(raw.color_desc[index]) for index in colours[:2, :2].ravel()]
        is_even = (colours[2:] == colours[:-2]).all() and (colours[:, 2:] == colours[:, :-2]).all()
        if not is_even or sorted(places) != ["B", "G", "G", "R"]:
            raise PhotographError(
                f"{path}: its mosaic is no Bayer pattern of red, green and blue; export it as "
                "16-bit linear TIFF"
            )
        light = bayer_colours(counts - black[colours], places)
        saturated = np.asarray(bayer_colours(full, places).any(axis=2))
    return Picture(_upright(light, flip), saturated=_upright(saturated, flip), cell=2)


def bayer_colours(counts: NDArray[Any], places: Sequence[str] = "RGGB") -> NDArray[Any]:
    """Return half-size colours, (rows, columns, 3), of (2 rows, 2 columns) Bayer counts.

    `places` are the colours of a cell, row-major; its two greens are averaged.
    """
    rows, columns = counts.shape[0] // 2, counts.shape[1] // 2
    colours = np.zeros((rows, columns, 3), np.result_type(counts, np.float32))
    for k, letter in enumerate(places):
        cells = counts[k // 2 : 2 * rows : 2, k % 2 : 2 * columns : 2]
        colours[..., "RGB".index(letter)] += cells / places.count(letter)
    return colours


def _upright(image: NDArray[Any], flip: int) -> NDArray[Any]:
    """Return a (rows, columns, ...) image as it is to be seen.

    The bits of LibRaw's `flip` reverse the columns, reverse the rows, and exchange both.
    """
    turned = image[:: -1 if flip & 2 else 1, :: -1 if flip & 1 else 1]
    return turned.swapaxes(0, 1) if flip & 4 else turned
