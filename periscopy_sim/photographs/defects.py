"""Pixels that do not measure light: saturated, dead and hot ones, found in one photograph.

Each channel is looked at alone, and a pixel is defective if one of its channels is. A test asks for
all of its conditions, so that it stays silent where noise or the wall itself may be the reason.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]
Mask = NDArray[np.bool_]

PLATEAU = 5
"""Fewest values at the top of a channel that make a plateau."""

LEVELS = 16
"""Fewest levels of a channel below its top: with fewer, flat parts and plateaus look the same."""

NEXT_LEVELS = 8
"""Levels next to the top, whose counts a plateau must exceed."""

DETACHED = 1 / 8
"""Part of a channel's range; a plateau that is farther above all else is one whatever they count.
"""

STRIP = 2**21
"""Values that medians are taken of at once; it bounds the memory."""

BAND = 1 << 20
"""Pixels that `single_defects` looks at together."""

EXCESS = 0.1
"""Part of the local median by which a hot pixel exceeds it at least, where there is no noise."""

_REACH = 4  # rows beyond a band that are looked at, too


@dataclass(frozen=True, eq=False)
class DefectivePixels:
    """Defective pixels of a photograph by kind.

    Attributes
    ----------
    saturated
        (rows, columns) bool, at the top of a channel that ends in a plateau.
    dead
        (rows, columns) bool, not above zero amid light.
    hot
        (rows, columns) bool, alone far above what surrounds them, and not saturated.
    """

    saturated: Mask
    dead: Mask
    hot: Mask

    def __str__(self) -> str:
        """Return how many there are of each kind, and where the first is."""
        counts = [int(np.count_nonzero(kind)) for kind in (self.saturated, self.dead, self.hot)]
        numbers = "{} saturated, {} dead and {} hot pixels".format(*counts)
        places = np.argwhere(self.any_kind)
        if not len(places):
            return numbers
        return f"{numbers}, the first in row {places[0, 0]}, column {places[0, 1]}"

    @property
    def any_kind(self) -> Mask:
        """Return (rows, columns) bool, the defective pixels of all kinds."""
        return self.saturated | self.dead | self.hot


def defective_pixels(
    photograph: NDArray[Any], mask: Mask | None = None, *, threshold: float = 7.0
) -> DefectivePixels:
    """Return the pixels of a photograph that should be left out.

    - Saturated: `PLATEAU` values or more that equal the largest of their channel, more than three
      times as many as any of the next `NEXT_LEVELS` levels has, or more than one and a half times
      as many as all of these together. The smooth maximum of a wall, however coarsely it is
      quantized, has fewer: of a ridge 2.4 times as many as the next level. (Of one that is flatter
      than a parabola, without noise and coarsely quantized, it may have as many as clipped light.)
    - Dead: not above zero, while at least three in four of the pixels beside it are well lit:
      above `threshold` standard deviations of the noise and a tenth of the channel's median. So
      dead lines are found, but dark areas and the edges of shadows are none.
    - Hot: above the median of the 24 pixels around it by `threshold` standard deviations of the
      noise, there and in the whole channel, and as many steps of quantization, and by a tenth of
      the median; with at most one pixel beside it that is half as far above, and none that is
      above by a quarter and by `threshold` standard deviations unless it is hot itself. So hot
      pixels are found alone and in pairs, but the edges of a poster, its stripes and letters are
      none; a bright dot as small as a pixel looks like one.

    Noise is estimated by the median deviation of pixels from their surroundings. Where it is white
    and Gaussian, a value is called hot at a rate of at most Q(threshold), its upper tail: for 7
    that is 1.3e-12, or one in 16 million photographs of 126 x 126 pixels. Defects that were
    averaged with sound pixels, as when a photograph is reduced in size, leave no such traces.

    Parameters
    ----------
    photograph
        (rows, columns, channels) or (rows, columns), in any linear unit.
    mask
        (rows, columns), True in the pixels to look at; None for all. Values that are not finite are
        left aside as well.
    threshold
        As above.

    Returns
    -------
    DefectivePixels

    Raises
    ------
    ValueError
        If the photograph has another number of dimensions, the mask another shape, or the threshold
        is not positive.
    """
    values = np.asarray(photograph, np.float64)
    if values.ndim == 2:
        values = values[..., np.newaxis]
    if values.ndim != 3:
        raise ValueError(f"the photograph has shape {values.shape}: give (rows, columns, channels)")
    if mask is not None and np.shape(mask) != values.shape[:2]:
        raise ValueError(f"the mask has shape {np.shape(mask)}: give {values.shape[:2]}")
    if not threshold > 0:
        raise ValueError(f"the threshold is {threshold}: give a positive number")
    found = np.zeros((3, *values.shape[:2]), bool)
    for channel in np.moveaxis(values, -1, 0):
        valid = np.isfinite(channel) & (True if mask is None else np.asarray(mask, bool))
        if valid.any():
            looked_at = np.where(valid, channel, np.nan)
            saturated = _saturated(looked_at, valid)
            dead, hot = _dead_and_hot(looked_at, valid, threshold)
            found |= np.stack([saturated, dead, hot])
    saturated, dead, hot = found
    return DefectivePixels(saturated, dead, hot & ~saturated)


def single_defects(photograph: NDArray[Any], mask: Mask | None = None) -> Mask:
    """Return where single pixels are dead or hot, as `defective_pixels` does by default.

    It looks at bands of rows, which bounds the memory that a large photograph needs.
    """
    rows, columns = size = photograph.shape[:2]
    height = max(BAND // columns, 4 * _REACH)
    found = np.zeros(size, bool)
    for start in range(0, rows, height):
        first = max(min(start, rows - height) - _REACH, 0)
        band = slice(first, start + height + _REACH)
        defects = defective_pixels(photograph[band], None if mask is None else mask[band])
        single = defects.dead | defects.hot
        found[start : start + height] = single[start - first : start - first + height]
    return found


def saturated_pixels(photograph: NDArray[Any]) -> Mask:
    """Return where a finite (rows, columns, channels) photograph is saturated, as a mask.

    That is told as by `defective_pixels`; a black level must not be taken off unevenly before.
    """
    everywhere = np.ones(photograph.shape[:2], bool)
    channels = [_saturated(photograph[..., k], everywhere) for k in range(photograph.shape[2])]
    return np.asarray(np.logical_or.reduce(channels))


def _saturated(channel: NDArray[Any], valid: Mask) -> Mask:
    levels, counts = np.unique(channel[valid], return_counts=True)
    found = np.zeros(channel.shape, bool)
    if len(levels) <= LEVELS or counts[-1] < PLATEAU:
        return found
    below = counts[-1 - NEXT_LEVELS : -1]
    is_detached = levels[-1] - levels[-2] > DETACHED * (levels[-1] - levels[0])
    if is_detached or counts[-1] > min(3 * below.max(), 1.5 * below.sum()):
        found = channel == levels[-1]
    return found


def _dead_and_hot(channel: Array, valid: Mask, threshold: float) -> tuple[Mask, Mask]:
    around, beside = _neighbours(channel, 2), _neighbours(channel, 1)
    median = _median(around)
    above = channel - median
    lit = valid & (channel > 0)
    measured = lit if lit.any() else valid  # where black is cut off at zero, it tells no noise
    level = float(np.median(channel[measured]))
    noise = _spread(above[measured]) + _step(channel[valid], level)

    floor = max(threshold * noise, 0.1 * level)
    bright = sum(neighbour > floor for neighbour in beside)
    dim = sum(neighbour <= floor for neighbour in beside)
    dead = valid & (channel <= 0) & (bright > 0) & (3 * dim <= bright)

    hot = above > np.maximum(threshold * noise, EXCESS * np.maximum(median, 0))
    hot &= sum(neighbour > median + above / 2 for neighbour in beside) <= 1
    # Light of an edge reaches the pixels beside it: those of a defect are sound, or defects too.
    lit_too, candidates = median + np.maximum(above / 4, threshold * noise), 0
    while candidates != (candidates := int(hot.sum())):
        others = _neighbours(np.where(hot, np.nan, channel), 1)
        hot &= sum(neighbour > lit_too for neighbour in others) == 0
    for pixel in np.argwhere(hot):
        place = tuple(pixel)
        deviations = np.array([neighbour[place] for neighbour in around]) - median[place]
        hot[place] = above[place] > threshold * _spread(deviations)
    return dead, hot


def _neighbours(channel: Array, reach: int) -> list[Array]:
    """Return views of the values at each offset of up to `reach` pixels; NaN outside."""
    rows, columns = channel.shape
    padded = np.pad(channel, reach, constant_values=np.nan)
    return [
        padded[down : down + rows, across : across + columns]
        for down in range(2 * reach + 1)
        for across in range(2 * reach + 1)
        if (down, across) != (reach, reach)
    ]


def _median(images: list[Array]) -> Array:
    """Return the median over images of what is not NaN, a strip of rows at a time; else NaN."""
    rows, columns = images[0].shape
    height = max(STRIP // (columns * len(images)), 1)
    strips = []
    for top in range(0, rows, height):
        ordered = np.sort(np.stack([image[top : top + height] for image in images]), axis=0)
        count = np.count_nonzero(~np.isnan(ordered), axis=0, keepdims=True)  # NaN comes last
        middle = (np.maximum(count - 1, 0) // 2, count // 2)
        low, high = (np.take_along_axis(ordered, place, axis=0)[0] for place in middle)
        strips.append((low + high) / 2)
    return np.concatenate(strips)


def _spread(deviations: Array) -> float:
    """Return the standard deviation of Gaussian noise with this median deviation."""
    magnitudes = np.abs(deviations[np.isfinite(deviations)])
    return 1.4826 * float(np.median(magnitudes)) if magnitudes.size else 0.0


def _step(values: Array, level: float) -> float:
    """Return the step of quantization, if it is one: of several, and no larger than the level."""
    steps = np.diff(np.unique(values))
    step = float(steps.min(initial=np.inf))
    return step if len(steps) > 1 and step <= level else 0.0
