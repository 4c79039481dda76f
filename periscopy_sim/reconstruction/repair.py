"""Post-repair of a reconstruction, Algorithm 2: patches that stick out become local medians."""

import math
from collections.abc import Callable
from typing import TypeVar

import numba
import numpy as np
from numpy.typing import ArrayLike, NDArray

Array = NDArray[np.float64]

Function = TypeVar("Function", bound=Callable[..., object])


def _compiled(function: Function) -> Function:
    compiled: Function = numba.njit(cache=True, nogil=True)(function)
    return compiled


def repair(image: ArrayLike, threshold: float) -> Array:
    """Replace the patches whose magnitude is far from their neighbours' mean (Algorithm 2).

    A patch's magnitude is its Euclidean norm over the channels; μ is the mean magnitude of its
    eight neighbours. Where the two differ by more than κ, each channel of the patch becomes the
    median of that channel over the 3 x 3 window about the patch, itself included. Every decision
    and median is of the image given, so that no repair depends on another.

    At the border only what lies within the image counts: five neighbours at an edge and three in
    a corner, six or four values for the median, which is then the average of the two in the
    middle. A single patch has no neighbours and stays.

    Parameters
    ----------
    image
        f̄, (rows, columns, channels), of a floating-point type, finite.
    threshold
        κ ≥ 0 in units of the image; infinity repairs nothing.

    Returns
    -------
    The repaired image, the same shape, float64.

    Raises
    ------
    TypeError
        The image is not of a real floating-point type.
    ValueError
        The image is empty, not finite or not of three dimensions, or the threshold is negative
        or NaN.
    """
    values = np.asarray(image)
    if not np.issubdtype(values.dtype, np.floating):
        raise TypeError(f"image is of type {values.dtype}: convert it to floating point")
    if values.ndim != 3 or values.size == 0:
        raise ValueError(f"image has shape {values.shape}: give (rows, columns, channels)")
    if not np.isfinite(values).all():
        raise ValueError("image holds NaN or infinity: replace those values first")
    if not threshold >= 0:
        raise ValueError(f"threshold is {threshold}: give a number that is not negative")
    values = np.ascontiguousarray(values, dtype=np.float64)
    repaired = values.copy()
    _replace_outliers(values, np.linalg.norm(values, axis=2), float(threshold), repaired)
    return repaired


@_compiled
def _replace_outliers(image: Array, magnitude: Array, threshold: float, repaired: Array) -> None:
    rows, columns, channels = image.shape
    for i in range(rows):
        for j in range(columns):
            if abs(magnitude[i, j] - _neighbour_mean(magnitude, i, j)) > threshold:
                window = image[max(i - 1, 0) : i + 2, max(j - 1, 0) : j + 2]
                for c in range(channels):
                    repaired[i, j, c] = np.median(window[:, :, c])


@_compiled
def _neighbour_mean(magnitude: Array, i: int, j: int) -> float:
    """Mean over the up to eight neighbours; NaN, which exceeds no threshold, if there are none."""
    rows, columns = magnitude.shape
    total = 0.0
    count = 0
    for k in range(max(i - 1, 0), min(i + 2, rows)):
        for m in range(max(j - 1, 0), min(j + 2, columns)):
            if k != i or m != j:
                total += magnitude[k, m]
                count += 1
    return total / count if count else math.nan
