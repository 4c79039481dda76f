"""Photographs of the relay wall, from every file format a camera's data come in, and masks.

Each is decoded as its format asks, prepared as what it is, and checked as all of its kind are.
"""

from dataclasses import replace
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from periscopy_sim.errors import PhotographError
from periscopy_sim.photograph import Photograph, check_size, with_channels
from periscopy_sim.photographs.defects import plateaus
from periscopy_sim.photographs.develop import SensorImage, sensor_image
from periscopy_sim.storage.formats.arrays import PHOTOGRAPH
from periscopy_sim.storage.formats.decoding import GAMMA, SRGB, Picture
from periscopy_sim.storage.formats.srgb import srgb_light
from periscopy_sim.storage.formats.table import decode_picture, format_of


def read_photograph(
    path: str | Path, shape: tuple[int, int], mask: NDArray[np.bool_] | None = None
) -> Photograph:
    """Read a photograph of a known size; its contents decide its format.

    EXR, NPY, NPZ (key `photograph`) and TIFF of floating-point numbers are linear light, and so are
    arrays of 8-bit integers, with a warning. PNG, TIFF and JPEG are what they declare, linear light
    or, with a warning, encoded by the sRGB curve; if they declare nothing, 16 bits are linear and 8
    bits encoded.

    Parameters
    ----------
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
    picture, warnings = _linear_light(path, shape)
    return Photograph.of(picture.values, shape, str(path), mask=mask, warnings=tuple(warnings))


def read_sensor_image(
    path: str | Path,
    white: float | None = None,
    *,
    has_black: bool = False,
    encoding: str | None = None,
) -> tuple[SensorImage, tuple[str, ...]]:
    """Read a photograph of any size, as `read_photograph` does, and where it is saturated.

    Raw files of cameras are linear, their black level off, without white balance, one pixel for
    each cell of the mosaic, without interpolation.

    Parameters
    ----------
    white : float
        The value from which on a pixel is saturated. None: what a raw file says, and the largest
        integer, if a converter's range ends there. A warning names other plateaus at the top.
    has_black : bool
        Whether a black level is still to be taken off, which is an error for pictures that are
        encoded for screens.
    encoding : str
        That of the frames whose companion the photograph is, and so of its integers. None: what
        the file declares.

    Returns
    -------
    (SensorImage, tuple of str)
        The photograph, and what had to be assumed or left out, one line each.

    Raises
    ------
    PhotographError
        If the file is missing, damaged, of another format or of another encoding.
    """
    picture, warnings = _linear_light(path, encoding=encoding)
    if picture.encoding == SRGB and (has_black or white is not None):
        raise PhotographError(
            f"{path}: is encoded for screens; give a raw file, or leave out the black level and "
            "the saturation"
        )
    exposure = sensor_image(picture.values, str(path), white, picture.saturated, picture.cell)
    is_known = white is not None or exposure.saturated.any()
    return exposure, (*warnings, *([] if is_known else plateaus(exposure.values, str(path))))


def _linear_light(
    path: str | Path, shape: tuple[int, int] | None = None, encoding: str | None = None
) -> tuple[Picture, list[str]]:
    """Decode a photograph, of a size if one is given, as linear light.

    Return it with the encoding that the file has, and what was assumed or left out, one line each.
    """
    row = format_of(Path(path))
    picture = row.decode(Path(path), PHOTOGRAPH, shape)
    values, full, wanted = picture.values, picture.saturated, encoding
    encoding = picture.encoding
    is_8_bits, kind = values.dtype == np.uint8, f"{8 * values.dtype.itemsize}-bit {row.name}"
    warnings = []
    if left_out := (*picture.left_out, *(() if picture.alpha is None else ("alpha",))):
        warnings.append(f"{path}: left out the channels {', '.join(left_out)}")
    if picture.unapplied:
        warnings.append(
            f"{path}: taken as the sensor counted, without the file's corrections "
            f"({', '.join(picture.unapplied)}); give a flat field, or export corrected linear TIFF"
        )
    if wanted is not None and values.dtype.kind in "iu":
        if wanted == SRGB != encoding and not is_8_bits:
            raise PhotographError(
                f"{path}: {kind}, but the frames are encoded for screens; save it as they are, or "
                "declare them linear"
            )
        encoding = wanted
    elif picture.is_display and is_8_bits and encoding in (None, GAMMA):
        encoding = SRGB
    if encoding == SRGB:
        white = np.iinfo(values.dtype).max
        values, full = srgb_light(values), (values == white).any(axis=2)
        warnings.append(
            f"{path}: {kind}, decoded by the sRGB curve; save linear data as 16-bit PNG or TIFF, "
            "EXR or NPY"
        )
    elif encoding == GAMMA or (encoding is None and is_8_bits):
        warnings.append(
            f"{path}: {kind}, taken as linear light, though such files often are gamma-encoded; "
            "if this one is, export linear light"
        )
    return replace(picture, values=values, encoding=encoding, saturated=full), warnings


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
    picture = decode_picture(path, "mask", shape)
    values = with_channels(picture.values, str(path))
    if picture.alpha is not None:
        values = np.where(picture.alpha > picture.alpha.max() / 2, values, 0)
    if shape is not None:
        check_size(values.shape[:2], shape, str(path))
    grey, largest = values[..., :1], values.max(initial=0)
    if largest == 0 and not values.any():
        raise PhotographError(f"{path}: a black mask leaves no pixel. Save the wall white")
    if (values != grey).any() or not 0 < largest < np.inf:  # also where one is NaN
        raise PhotographError(f"{path}: not a greyscale mask. Save the wall white, the rest black")
    # A quotient, since half of the largest integer may be no integer.
    return np.asarray(grey[..., 0] / largest > 0.5)
