"""Photographs of the relay wall, from every file format a camera's data come in, and masks.

Each is decoded as its format asks, prepared as what it is, and checked as all of its kind are.
"""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from periscopy_sim.errors import PhotographError
from periscopy_sim.photograph import Photograph, check_size, with_channels
from periscopy_sim.photographs.defects import saturated_pixels
from periscopy_sim.photographs.sensor_image import SensorImage, sensor_image
from periscopy_sim.storage.formats.arrays import PHOTOGRAPH
from periscopy_sim.storage.formats.decoding import GAMMA, SRGB, Picture
from periscopy_sim.storage.formats.matlab import averaged_counts
from periscopy_sim.storage.formats.srgb import srgb_decode
from periscopy_sim.storage.formats.table import decode_picture, format_of


def read_photograph(
    path: str | Path, shape: tuple[int, int], mask: NDArray[np.bool_] | None = None
) -> Photograph:
    """Read a photograph of a known size; its contents decide its format.

    EXR, NPY, NPZ (key `photograph`) and TIFF of floating-point numbers are linear light, and so are
    arrays of 8-bit integers, with a warning. PNG, TIFF and JPEG are what they declare, linear light
    or, with a warning, encoded by the sRGB curve; if they declare nothing, 16 bits are linear and 8
    bits encoded. MATLAB files hold raw counts, see `read_matlab_counts`.

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
        If the file is missing, damaged, of another format, or fails `Photograph.of`.
    """
    name, kind, picture, encoded = _decoded(path)
    values, warnings = _linear_light(picture, encoded, shape, kind, name)
    return Photograph.of(values, shape, name, mask=mask, warnings=tuple(warnings))


def read_sensor_image(
    path: str | Path, white: float | None = None, *, has_black: bool = False
) -> tuple[SensorImage, tuple[str, ...]]:
    """Read a photograph of any size, as `read_photograph` does, and where it is saturated.

    Raw files of cameras are linear, their black level off, without white balance, one pixel for
    each cell of the mosaic, without interpolation.

    Parameters
    ----------
    path : Path
        The file.
    white : float
        The value from which on a pixel is saturated. None: what a raw file says, and the largest
        integer, if a converter's range ends there. A warning names other plateaus at the top.
    has_black : bool
        Whether a black level is still to be taken off, which is an error for pictures that are
        encoded for screens.

    Returns
    -------
    (SensorImage, tuple of str)
        The photograph, and what had to be assumed or left out, one line each.

    Raises
    ------
    PhotographError
        If the file is missing, damaged or of another format.
    """
    name, kind, picture, encoded = _decoded(path)
    values, full = picture.values, picture.saturated
    if encoded:
        if has_black or white is not None:
            raise PhotographError(
                f"{name}: is encoded for screens; give a raw file, or leave out the black level "
                "and the saturation"
            )
        full = (values == np.iinfo(values.dtype).max).any(axis=2)
    light, warnings = _linear_light(picture, encoded, None, kind, name)
    exposure = sensor_image(light, name, white, full, picture.cell)
    is_known = white is not None or exposure.saturated.any()
    if not is_known and (plateau := saturated_pixels(exposure.values)).any():
        top = exposure.values[plateau].max(axis=1).min()
        warnings.append(
            f"{name}: {np.count_nonzero(plateau)} pixels end in a plateau at {top:.6g}; if they "
            f"are saturated, name this value as white"
        )
    return exposure, tuple(warnings)


def _decoded(path: str | Path) -> tuple[str, str, Picture, bool]:
    """Return name, format and content of a photograph, and whether it is sRGB-encoded."""
    row = format_of(Path(path))
    picture = row.decode(Path(path), PHOTOGRAPH)
    encoded = picture.encoding == SRGB
    if picture.encoding in (None, GAMMA):
        encoded = picture.is_display and picture.values.dtype == np.uint8
    return str(path), row.name, picture, encoded


def _linear_light(
    picture: Picture, encoded: bool, shape: tuple[int, int] | None, kind: str, name: str
) -> tuple[NDArray[Any], list[str]]:
    """Return linear light, of a size if one is asked for, and what was assumed or left out."""
    values, warnings = picture.values, []
    bits = 8 * values.dtype.itemsize
    if picture.exposure is not None:
        values = averaged_counts(values, picture.exposure, shape or values.shape[:2], name)
    if picture.left_out:
        warnings.append(f"{name}: left out the channels {', '.join(picture.left_out)}")
    if picture.alpha is not None:
        warnings.append(f"{name}: left out the alpha channel")
    if encoded:
        if shape is not None:
            check_size(values.shape[:2], shape, name)  # before it becomes eight times as large
        why = "as the file says" if picture.encoding == SRGB else "which is normally encoded"
        warnings.append(
            f"{name}: {bits}-bit {kind}, {why}: decoded by the sRGB curve; save linear data as "
            "16-bit PNG or TIFF, EXR or NPY"
        )
        values = srgb_decode(np.linspace(0, 1, 2**bits))[values]
    elif picture.encoding == GAMMA or (picture.encoding is None and values.dtype == np.uint8):
        warnings.append(
            f"{name}: {bits}-bit {kind}, taken as linear light, though such files often are "
            "gamma-encoded; if this one is, save it as PNG with an sRGB profile"
        )
    return values, warnings


def read_mask(path: str | Path, shape: tuple[int, int] | None = None) -> NDArray[np.bool_]:
    """Read where the wall is used from a picture: bright there, black where it is left out.

    Bright is what lies above half of the picture's largest value, whatever the bit depth; truth
    values are taken as they are. What is transparent is left out.

    Parameters
    ----------
    path : Path
        PNG, TIFF, JPEG, EXR, NPY, or NPZ (key `mask`): grey, or with equal channels.
    shape : (rows, columns)
        Size of the photograph, which the mask must have. None: any.

    Returns
    -------
    (rows, columns) bool
        True where the wall is used.

    Raises
    ------
    PhotographError
        If the file is missing, damaged, of another format or size, coloured, not finite, or leaves
        out every pixel.
    """
    path = Path(path)
    picture = decode_picture(path, "mask")
    values = with_channels(picture.values, str(path))
    if picture.alpha is not None:
        values = np.where(picture.alpha > picture.alpha.max() / 2, values, 0)
    if shape is not None:
        check_size(values.shape[:2], shape, str(path))
    if not np.isfinite(values).all():
        raise PhotographError(f"{path}: has NaN or infinite values; give truth values")
    if (values != values[..., :1]).any():
        raise PhotographError(f"{path}: has colours; a mask is grey: is this the photograph?")
    largest = values.max()
    # A quotient, since half of the largest integer may be no integer.
    if largest <= 0 or not (mask := values[..., 0] / largest > 0.5).any():
        raise PhotographError(
            f"{path}: leaves out every pixel; it must be bright where the wall is to be used"
        )
    return np.asarray(mask)
