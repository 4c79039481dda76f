"""Raw files of cameras, read by LibRaw: the sensor's counts, linear, colours as measured.

Each 2 x 2 cell of the Bayer mosaic becomes one pixel: its red, its blue and the mean of its two
greens. Nothing is interpolated, as demosaicing would, so noise stays white; there is no white
balance, no colour matrix and no gamma.
"""

from __future__ import annotations

from contextlib import suppress
from pathlib import Path

import numpy as np

from periscopy_sim.errors import PhotographError
from periscopy_sim.storage.formats.decoding import Picture, decoding, upright
from periscopy_sim.storage.formats.matlab import bayer_colours
from periscopy_sim.storage.formats.rasters import reaches_its_pixels

RAW_SUFFIXES = (
    ".dng", ".nef", ".nrw", ".arw", ".srf", ".sr2", ".cr2", ".cr3", ".pef", ".raf", ".orf", ".rw2",
    ".srw", ".3fr", ".erf", ".iiq", ".mef", ".mos", ".kdc", ".dcr", ".rwl",
)  # fmt: skip
"""Of files that mostly have the signature of TIFF."""

RAW_SIGNATURES = (
    (4, b"ftypcrx "), (0, b"FUJIFILMCCD-RAW"), (0, b"IIRO"), (0, b"IIRS"), (0, b"MMOR"),
    (0, b"IIU\x00"),
)  # fmt: skip
"""Of the others: Canon's CR3, Fujifilm, Olympus, Panasonic."""


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
        if raw.num_colors == 1:
            light = (counts - np.float32(raw.black_level_per_channel[0]))[..., np.newaxis]
            return Picture(upright(light, flip), saturated=upright(full, flip))
        colours = raw.raw_colors_visible
        places = [chr(raw.color_desc[index]) for index in colours[:2, :2].ravel()]
        is_even = (colours[2:] == colours[:-2]).all() and (colours[:, 2:] == colours[:, :-2]).all()
        if not is_even or sorted(places) != ["B", "G", "G", "R"]:
            raise PhotographError(
                f"{path}: its mosaic is no Bayer pattern of red, green and blue; export it as "
                "16-bit linear TIFF"
            )
        counts -= np.array(raw.black_level_per_channel, np.float32)[colours]
        light = bayer_colours(counts, places)
        saturated = np.asarray(bayer_colours(full, places).any(axis=2))
    return Picture(upright(light, flip), saturated=upright(saturated, flip), cell=2)
