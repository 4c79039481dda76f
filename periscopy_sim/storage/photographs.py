"""Photographs of the relay wall, from every file format a camera's data come in.

Each is decoded as its format asks, prepared as what it is, and checked as all photographs are.
"""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from periscopy_sim.photographs.checking import Photograph, check_size, checked_photograph
from periscopy_sim.storage.formats.matlab import averaged_counts
from periscopy_sim.storage.formats.picture import Picture
from periscopy_sim.storage.formats.srgb import srgb_decode
from periscopy_sim.storage.formats.table import format_of


def read_photograph(
    path: str | Path, shape: tuple[int, int], mask: NDArray[np.bool_] | None = None
) -> Photograph:
    """Read a photograph of a known size; its format is told by its contents.

    EXR, NPY, NPZ (key `photograph`) and TIFF of floating-point numbers are linear light; 16-bit
    PNG and integer TIFF are linear counts, taken as they are; PNG, TIFF and JPEG of 8 bits are
    decoded by the sRGB curve, with a warning; MATLAB files hold raw counts, see
    `read_matlab_counts`.

    Parameters
    ----------
    path : Path
        The file.
    shape : (rows, columns)
        Size that the photograph must have.
    mask : (rows, columns) bool
        True where the wall is used; elsewhere the photograph may hold anything, also NaN, and
        keeps it. Give the mask to the method too, which leaves those pixels out. None: everywhere.

    Raises
    ------
    PhotographError
        If the file is missing, damaged, of another format, or no photograph: see
        `check_photograph`.
    """
    path = Path(path)
    row = format_of(path)
    picture = row.decode(path, "photograph", shape)
    values, warnings = _prepared(picture, shape, row.name, str(path))
    return checked_photograph(values, shape, str(path), mask, warnings)


def _prepared(
    picture: Picture, shape: tuple[int, int], kind: str, name: str
) -> tuple[NDArray[Any], list[str]]:
    """Return linear light, and what was assumed or left out."""
    values, warnings = picture.values, []
    if picture.exposure is not None:
        values = averaged_counts(values, picture.exposure, shape, name)
    if picture.left_out:
        warnings.append(f"{name}: left out the channels {', '.join(picture.left_out)}")
    if picture.alpha is not None:
        warnings.append(f"{name}: left out the alpha channel")
    if picture.is_display and values.dtype == np.uint8:
        check_size(values.shape[:2], shape, name)  # before it becomes eight times as large
        values = srgb_decode(values / 255)
        warnings.append(
            f"{name}: 8-bit {kind}, which is normally gamma-encoded, so decoded by the sRGB "
            "curve; save linear data as 16-bit PNG or TIFF, EXR or NPY"
        )
    return values, warnings
