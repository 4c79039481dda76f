"""Post-repair of a reconstruction, Algorithm 2: patches that stick out become local medians."""

import math
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from periscopy_sim.numerics.compilation import compiled
from periscopy_sim.numerics.threads import in_parallel, ranges
from periscopy_sim.numerics.validation import checked_companion, checked_image

Array = NDArray[Any]  # of the type of the image given

_SMALL = 1 << 18
"""Values in all below which waking threads takes longer than the work they share."""


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
        f̄, (rows, columns, channels) or a stack (images, rows, columns, channels), each repaired
        on its own; of a floating-point type, finite.
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
    if values.ndim not in (3, 4) or values.size == 0:
        raise ValueError(
            f"image has shape {values.shape}: give (rows, columns, channels) or "
            "(images, rows, columns, channels)"
        )
    if not threshold >= 0:
        raise ValueError(f"threshold is {threshold}: give a number that is not negative")
    frames = values.reshape(-1, *values.shape[-3:])
    before = frames
    if previous is not None:
        before = checked_companion(previous, "previous", values).reshape(frames.shape)
    repaired = frames.copy()

    def replace(part: tuple[int, int]) -> None:
        _replace_outliers(frames, before, previous is not None, float(threshold), *part, repaired)

    if frames.size < _SMALL:
        replace((0, len(frames)))
    else:
        in_parallel(replace, ranges(len(frames)))
    return repaired.reshape(values.shape)


@compiled
def _replace_outliers(
    frames: Array,
    before: Array,
    is_video: bool,
    threshold: float,
    start: int,
    stop: int,
    repaired: Array,
) -> None:
    """Repair the frames `start` to `stop`, (frames, rows, columns, channels), into a copy."""
    _, rows, columns, channels = frames.shape
    magnitude = np.zeros((rows + 2, columns + 2))
    deviation = np.empty(columns)
    window = np.empty(18, frames.dtype)
    for k in range(start, stop):
        _set_magnitudes(frames[k], magnitude)
        for i in range(rows):
            _set_deviations(magnitude, i, deviation)
            for j in range(columns):
                if deviation[j] > threshold:
                    for c in range(channels):
                        count = _gather(frames[k], i, j, c, not is_video, window)
                        if is_video:
                            count += _gather(before[k], i, j, c, is_video, window[count:])
                        repaired[k, i, j, c] = _median(window[:count])


@compiled
def _set_magnitudes(image: Array, magnitude: NDArray[np.float64]) -> None:
    """Set each patch's Euclidean norm, within a border of zeros one patch wide."""
    rows, columns, channels = image.shape
    for i in range(rows):
        row = magnitude[i + 1, 1 : columns + 1]
        row[:] = 0
        for c in range(channels):
            for j in range(columns):
                value = np.float64(image[i, j, c])
                row[j] += value * value
        for j in range(columns):
            row[j] = math.sqrt(row[j])


@compiled
def _set_deviations(magnitude: NDArray[np.float64], i: int, deviation: NDArray[np.float64]) -> None:
    """Set |‖f_i‖ − μ| along a row; NaN, which exceeds no threshold, without neighbours."""
    rows, columns = magnitude.shape[0] - 2, magnitude.shape[1] - 2
    above, here, below = magnitude[i], magnitude[i + 1], magnitude[i + 2]
    high = 3 - (i == 0) - (i == rows - 1)
    for j in range(columns):
        wide = 3 - (j == 0) - (j == columns - 1)
        around = above[j] + above[j + 1] + above[j + 2] + here[j] + here[j + 2]
        around += below[j] + below[j + 1] + below[j + 2]
        deviation[j] = abs(here[j + 1] - around / (high * wide - 1))


@compiled
def _gather(image: Array, i: int, j: int, c: int, with_itself: bool, window: Array) -> int:
    """Copy one channel of the window about a patch, and count its values."""
    rows, columns, _ = image.shape
    count = 0
    for k in range(max(i - 1, 0), min(i + 2, rows)):
        for m in range(max(j - 1, 0), min(j + 2, columns)):
            if with_itself or k != i or m != j:
                window[count] = image[k, m, c]
                count += 1
    return count


@compiled
def _median(values: Array) -> float:
    """Median of a few values, which are left sorted by insertion."""
    count = len(values)
    for k in range(1, count):
        value = values[k]
        place = k
        while place > 0 and values[place - 1] > value:
            values[place] = values[place - 1]
            place -= 1
        values[place] = value
    middle: float = values[count // 2]
    return middle if count % 2 else (values[count // 2 - 1] + middle) / 2
