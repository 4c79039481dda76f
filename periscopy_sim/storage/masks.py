"""Masks: pictures of where the wall is used."""

from __future__ import annotations

from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from periscopy_sim.errors import PhotographError
from periscopy_sim.photographs.checking import check_size
from periscopy_sim.storage.formats.table import decode_picture


def read_mask(path: str | Path, shape: tuple[int, int]) -> NDArray[np.bool_]:
    """Read where the wall is used from a picture: bright there, black where it is left out.

    Bright is what lies above half of the picture's largest value, whatever the bit depth; truth
    values are taken as they are. What is transparent is left out.

    Parameters
    ----------
    path : Path
        PNG, TIFF, JPEG, EXR, NPY, or NPZ (key `mask`): grey, or with equal channels.
    shape : (rows, columns)
        Size of the photograph, which the mask must have.

    Returns
    -------
    (rows, columns) bool
        True where the wall is used.

    Raises
    ------
    PhotographError
        If the file is missing, damaged, of another format or size, coloured, has NaN or infinite
        values, or leaves out every pixel.
    """
    path = Path(path)
    picture = decode_picture(path, "mask")
    values = picture.values
    if picture.alpha is not None:
        values = np.where(picture.alpha > picture.alpha.max() / 2, values, 0)
    if values.ndim == 2:
        values = values[..., np.newaxis]
    if values.ndim != 3 or values.shape[2] not in (1, 3):
        raise PhotographError(f"{path}: has shape {values.shape}; give (rows, columns)")
    check_size(values.shape[:2], shape, str(path))
    if not np.isfinite(values).all():
        raise PhotographError(f"{path}: has NaN or infinite values; give truth values")
    if (values != values[..., :1]).any():
        raise PhotographError(f"{path}: has colours; a mask is grey: is this the photograph?")
    # A quotient, since half of the largest integer may be no integer.
    largest = values.max()
    mask: NDArray[np.bool_] = values[..., 0] / (largest or 1) > 0.5
    if largest <= 0 or not mask.any():
        raise PhotographError(
            f"{path}: leaves out every pixel; it must be bright where the wall is to be used"
        )
    return mask
