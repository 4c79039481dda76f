"""Post-repair of a reconstruction, Algorithm 2: patches that stick out become local medians."""

from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray
from scipy import ndimage

from periscopy_sim.numerics.validation import checked_companion, checked_image

Array = NDArray[Any]  # of the type of the image given


def repair(image: ArrayLike, threshold: float, previous: ArrayLike | None = None) -> Array:
    """Replace the patches whose magnitude is far from their neighbours' mean (Algorithm 2).

    A patch's magnitude is its Euclidean norm over the channels; μ is the mean magnitude of its
    eight neighbours. Where the two differ by more than κ, each channel of the patch becomes the
    median of that channel over the 3 x 3 window about the patch, itself included. Every decision
    and median is of the image given, so that no repair depends on another.

    In a video the window reaches into the previous frame (3 x 3 x 2, Sec. 3.2): the median is
    taken over the eight neighbours, without the patch itself, and the nine patches of the previous
    frame. μ remains that of the eight neighbours: where a whole region has changed, the previous
    frame would make its every patch stick out, and be put back to what it was.

    At the border only what lies within the image counts: five neighbours at an edge and three in
    a corner. A still's median is then of six or four values, the average of the two in the
    middle; a video's of eleven or seven. A single patch has no neighbours and stays.

    Parameters
    ----------
    image
        f̄, (rows, columns, channels), of a floating-point type, finite.
    threshold
        κ ≥ 0 in units of the image; infinity repairs nothing.
    previous
        The previous frame, finite, of the shape of the image; None for a still.

    Returns
    -------
    The repaired image, of the same shape and type, float32 at least and float64 at most.

    Raises
    ------
    TypeError
        The image or the previous frame is not of a real floating-point type.
    ValueError
        The image is empty, not finite or of another dimension, the previous frame is not finite or
        of another shape, or the threshold is negative or NaN.
    """
    values = checked_image(image)
    if values.ndim != 3 or values.size == 0:
        raise ValueError(f"image has shape {values.shape}: give (rows, columns, channels)")
    if not threshold >= 0:
        raise ValueError(f"threshold is {threshold}: give a number that is not negative")
    magnitude = np.linalg.norm(values.astype(np.float64), axis=-1)
    ring = np.array([[1, 1, 1], [1, 0, 1], [1, 1, 1]])
    total, count = (
        ndimage.convolve(each, ring, mode="constant")
        for each in (magnitude, np.ones(magnitude.shape))
    )
    outliers = np.abs(magnitude - total / np.maximum(count, 1)) > threshold
    outliers &= count > 0
    windows = _windows(values, outliers)
    if previous is not None:
        windows[..., 4] = np.nan
        before = checked_companion(previous, "previous", values)
        windows = np.concatenate([windows, _windows(before, outliers)], axis=-1)
    repaired = values.copy()
    repaired[outliers] = np.nanmedian(windows, axis=-1)
    return repaired


def _windows(image: Array, where: NDArray[np.bool_]) -> Array:
    """Return the 3 x 3 windows about some patches, (n, channels, 9), NaN beyond the border."""
    padded = np.pad(image, ((1, 1), (1, 1), (0, 0)), constant_values=np.nan)
    windows = np.lib.stride_tricks.sliding_window_view(padded, (3, 3), axis=(0, 1))[where]
    return windows.reshape(*windows.shape[:2], 9)
