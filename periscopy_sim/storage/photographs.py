"""Photographs of the relay wall, from every file format a camera's data come in."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from periscopy_sim.errors import PhotographError
from periscopy_sim.storage.formats.arrays import check_real, read_npy, read_npz
from periscopy_sim.storage.formats.decoding import file_format
from periscopy_sim.storage.formats.exr import decode_exr
from periscopy_sim.storage.formats.matlab import read_matlab_photograph
from periscopy_sim.storage.formats.rasters import png_size, read_raster
from periscopy_sim.storage.formats.srgb import srgb_decode

_DIMMEST = 1e-30
"""Least that a photograph's largest value may be, and its inverse the most: P is of single
precision, and what is far from 1 would vanish or overflow in it."""


@dataclass(frozen=True, eq=False)
class Photograph:
    """A photograph as read from a file.

    Attributes
    ----------
    values : (rows, columns, 3) float64
        Linear light; row 0 is the top.
    warnings : tuple of str
        What had to be assumed or left out, one line each.
    """

    values: NDArray[np.float64]
    warnings: tuple[str, ...] = ()

    def __array__(
        self, dtype: np.dtype[Any] | None = None, copy: bool | None = None
    ) -> NDArray[Any]:
        """Serve as `values` wherever an array is taken."""
        return np.array(self.values, dtype=dtype, copy=copy)


def read_photograph(
    path: str | Path, shape: tuple[int, int], mask: NDArray[np.bool_] | None = None
) -> Photograph:
    """Read a photograph of a known size; its format is told by its contents.

    EXR, NPY, NPZ (key `photograph`) and TIFF of floating-point numbers are linear light; 16-bit
    PNG and integer TIFF are linear counts, taken as they are; PNG, TIFF and JPEG of 8 bits are
    decoded by the sRGB curve, with a warning; MATLAB files hold raw counts, see
    `read_matlab_photograph`.

    Parameters
    ----------
    path : Path
        The file.
    shape : (rows, columns)
        Size that the photograph must have.
    mask : (rows, columns) bool
        True where the wall is used; elsewhere the photograph may hold anything, also NaN, and
        is returned as zero. None: everywhere.

    Raises
    ------
    PhotographError
        If the file is missing, damaged, of another format, or fails `check_photograph`.
    """
    path = Path(path)
    kind = file_format(path)
    warnings: tuple[str, ...] = ()
    values: NDArray[Any]
    if kind == "EXR":
        image = decode_exr(path)
        values = image.colour
        if image.left_out:
            warnings = (f"{path}: left out the channels {', '.join(image.left_out)}",)
    elif kind == "NPY":
        values = read_npy(path)
    elif kind == "NPZ":
        values = read_npz(path, "photograph")
    elif kind == "MATLAB":
        values = read_matlab_photograph(path, shape)
    elif kind == "MATLAB 7.3":
        raise PhotographError(f"{path}: is a MATLAB 7.3 (HDF5) file; save it with -v7")
    else:
        if kind == "PNG":  # decoding 16 bits is slow: not for a photograph that cannot fit
            check_size(png_size(path), shape, str(path))
        values, warnings = _read_raster_photograph(path, kind, shape)
    return Photograph(check_photograph(values, shape, str(path), mask), warnings)


def check_photograph(
    values: ArrayLike,
    shape: tuple[int, int],
    name: str,
    mask: NDArray[np.bool_] | None = None,
) -> NDArray[np.float64]:
    """Check that an array can be a photograph, and bring it to its one form.

    Parameters
    ----------
    values : (rows, columns), (rows, columns, 1) or (rows, columns, 3)
        Finite real numbers, the largest from 1e-30 to 1e30; negatives may come of subtracted dark
        frames. A single channel is grey.
    shape : (rows, columns)
        Size that the photograph must have.
    name : str
        What to call the array in messages.
    mask : (rows, columns) bool
        True where the wall is used; elsewhere the photograph may hold anything, also NaN, and
        is returned as zero. None: everywhere.

    Returns
    -------
    (rows, columns, 3) float64
        A new array.

    Raises
    ------
    PhotographError
        If any of this does not hold.
    """
    try:
        array = np.asarray(values)
    except ValueError as error:  # rows of different lengths
        raise PhotographError(f"{name}: is no array of numbers ({error}); give one") from error
    check_real(array.dtype, name)
    if array.ndim == 2:
        array = array[..., None]
    if array.ndim != 3 or array.shape[2] not in (1, 3):
        raise PhotographError(
            f"{name}: has shape {np.shape(values)}; give (rows, columns, 3), or one channel of grey"
        )
    check_size(array.shape[:2], shape, name)
    # What is out of range becomes infinite, and is refused below; so are signalling NaNs.
    with np.errstate(over="ignore", invalid="ignore"):
        photograph = np.asarray(array, dtype=np.float64)
    if mask is not None:
        if mask.shape != tuple(shape):
            raise PhotographError(f"{name}: the mask has shape {mask.shape}, not {tuple(shape)}")
        photograph = np.where(mask[..., np.newaxis], photograph, 0)
    broken = np.argwhere(~np.isfinite(photograph))
    if len(broken):
        row, column, channel = broken[0]
        raise PhotographError(
            f"{name}: {len(broken)} values are NaN or infinite, the first at row {row}, "
            f"column {column}, channel {channel}; replace them, or leave them out by a mask"
        )
    if not photograph.any():
        raise PhotographError(f"{name}: every value is zero; check the exposure or the export")
    largest = np.abs(photograph).max()
    if not _DIMMEST <= largest <= 1 / _DIMMEST:
        raise PhotographError(f"{name}: its largest value is {largest:.3g}; scale it to about 1")
    return np.repeat(photograph, 3 // photograph.shape[2], axis=2)


def check_size(size: tuple[int, ...], shape: tuple[int, int], name: str) -> None:
    """Check that a photograph is as large as the scene's camera sees it.

    Parameters
    ----------
    size : (rows, columns)
        What it has.
    shape : (rows, columns)
        What it must have.
    name : str
        What to call it in messages.

    Raises
    ------
    PhotographError
        If they differ; the message says both, and whether averaging blocks would mend it.
    """
    if tuple(size) == tuple(shape):
        return
    k = size[0] // shape[0]
    if k > 1 and tuple(size) == (k * shape[0], k * shape[1]):
        mend = f"average {k} x {k} blocks first"
    else:
        mend = "crop and average it to that size, or change the film size in the scene"
    raise PhotographError(
        f"{name}: {size[0]} x {size[1]} pixels (rows x columns), but the scene's camera has "
        f"{shape[0]} x {shape[1]}; {mend}"
    )


def _read_raster_photograph(
    path: Path, kind: str, shape: tuple[int, int]
) -> tuple[NDArray[Any], tuple[str, ...]]:
    """Values of a PNG, TIFF or JPEG photograph, and what was assumed of it."""
    raster = read_raster(path, kind)
    values, warnings = raster.colour, []
    check_size(values.shape[:2], shape, str(path))
    if raster.alpha is not None:
        warnings.append(f"{path}: left out the alpha channel")
    if values.dtype == np.uint8:
        values = srgb_decode(values / 255)
        warnings.append(
            f"{path}: 8-bit {kind}, which is normally gamma-encoded, so decoded by the sRGB "
            "curve; save linear data as 16-bit PNG or TIFF, EXR or NPY"
        )
    return values, tuple(warnings)
