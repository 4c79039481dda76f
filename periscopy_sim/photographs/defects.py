"""Detection of pixels that do not measure light in one photograph: saturated, dead and hot ones.

Each channel is examined alone, and a pixel is defective if one of its channels is. All conditions
of a test must hold: noise or the wall itself may explain one of them. The numbers are those by
which tests/photographs/test_defects.py finds every planted defect, and none on sound walls.
"""

from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from periscopy_sim.numerics import Array, Mask
from periscopy_sim.photograph import Photograph, common_pixels, with_channels

PLATEAU = 5
"""Fewest values at the top of a channel that make a plateau."""

LEVELS = 16
"""Fewest levels of a channel below its top: with fewer, flat parts and plateaus look the same."""

DETACHED_GAP = 1 / 8
"""Gap below the top level, as a fraction of a channel's range, that alone makes a plateau."""

THRESHOLD = 7.0
"""Standard deviations of the noise that a defect stands out by.

White Gaussian noise exceeds them at a rate of 1.3e-12: once in 16 million photographs of 126 x 126
pixels.
"""

HOT_EXCESS = 0.1
"""Excess of a hot pixel over the median around it, as a fraction of that, without noise."""


@dataclass(frozen=True, eq=False)
class DefectivePixels:
    """Defective pixels of a photograph by kind, (rows, columns) bool each."""

    saturated: Mask  # at the top of a channel that ends in a plateau
    dead: Mask  # not above zero amid light
    hot: Mask  # alone far above the pixels around, and not saturated

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
        """The defective pixels of all kinds."""
        return self.saturated | self.dead | self.hot


def defective_pixels(
    photograph: Photograph | NDArray[Any], mask: Mask | None = None
) -> DefectivePixels:
    """Return the pixels of a photograph to exclude.

    - Saturated: `PLATEAU` values or more that equal the largest of their channel, more than one and
      a half times as many as the next eight levels together. The smooth maximum of a wall, however
      coarsely it is quantized, has fewer. (Without noise and coarsely quantized, a maximum flatter
      than a parabola may have as many as clipped light.)
    - Dead: not above zero, while at least three in four of the pixels beside it are well lit: above
      `THRESHOLD` standard deviations of the noise and a tenth of the channel's median. Dead lines
      are found; dark areas and the edges of shadows are none.
    - Hot: above the median of the 24 pixels around it by `THRESHOLD` standard deviations of the
      noise, there and in the whole channel, and as many steps of quantization, and by a tenth of
      the median; with at most one pixel beside it that is half as far above, and none that is above
      by a quarter and by `THRESHOLD` standard deviations unless it is hot itself. Hot pixels are
      found alone and in pairs; the edges of a poster, its stripes and letters are none. A bright
      dot as small as a pixel looks like one.

    The median deviation of pixels from their surroundings estimates the noise. Averages over
    defects and sound pixels, as in a photograph reduced in size, leave no such traces.

    Parameters
    ----------
    photograph
        A `Photograph`; or (rows, columns, channels) or (rows, columns), in any linear unit.
    mask
        (rows, columns), True in the pixels to examine; None for all. Values that are not finite are
        left aside as well.
    """
    if isinstance(photograph, Photograph):
        mask, photograph = common_pixels(mask, photograph.mask), photograph.values
    values = with_channels(np.asarray(photograph), "the photograph")
    used: Mask = np.ones(values.shape[:2], bool) if mask is None else np.asarray(mask, bool)
    if used.shape != values.shape[:2]:
        raise ValueError(f"the photograph has shape {values.shape}, the mask {used.shape}")
    saturated, dead, hot = kinds = np.zeros((3, *values.shape[:2]), bool)
    for light in np.moveaxis(values, -1, 0):
        channel = np.asarray(light, np.float64)
        valid = np.isfinite(channel) & used
        if valid.any():
            saturated |= _saturated(channel, valid)
            kinds[1:] |= _dead_and_hot(channel, valid)
    return DefectivePixels(saturated, dead, hot & ~saturated)


def saturated_pixels(photograph: NDArray[Any]) -> Mask:
    """Return where a finite (rows, columns, channels) photograph is saturated.

    The test is that of `defective_pixels`; a black level must not be subtracted unevenly before.
    """
    everywhere = np.ones(photograph.shape[:2], bool)
    channels = [_saturated(each, everywhere) for each in np.moveaxis(photograph, -1, 0)]
    return np.asarray(np.any(channels, axis=0))


def _saturated(channel: NDArray[Any], valid: Mask) -> Mask:
    levels, counts = np.unique(channel[valid], return_counts=True)
    if len(levels) <= LEVELS or counts[-1] < PLATEAU:
        return np.zeros(channel.shape, bool)
    is_detached = levels[-1] - levels[-2] > DETACHED_GAP * (levels[-1] - levels[0])
    is_plateau = is_detached or counts[-1] > 1.5 * counts[-9:-1].sum()
    return np.asarray(valid & (channel == levels[-1]) & is_plateau)


def _dead_and_hot(channel: Array, valid: Mask) -> NDArray[np.bool_]:
    """Return the dead and the hot pixels of a channel, (2, rows, columns), some of it valid."""
    from scipy import ndimage

    beside = np.ones((3, 3), bool)
    beside[1, 1] = False
    around = np.pad(beside, 1, constant_values=True)
    # What is not valid shows the nearest valid pixel: its own value must move no median.
    nearest = ndimage.distance_transform_edt(~valid, return_distances=False, return_indices=True)
    light = channel[tuple(nearest)]
    median = ndimage.median_filter(light, footprint=around, mode="mirror")
    above = light - median
    lit = valid & (light > 0)
    measured = lit if lit.any() else valid  # black cut off at zero shows no noise
    level = float(np.median(light[measured]))
    steps = np.diff(np.unique(light[valid]))
    step = float(steps.min(initial=np.inf))
    # Steps of quantization hide noise that is smaller than they are; steps above the level are no
    # quantization but a picture of a few values.
    noise = _spread(above[measured]) + (step if len(steps) > 1 and step <= level else 0.0)

    is_bright = light > max(THRESHOLD * noise, 0.1 * level)
    bright, dim = (
        ndimage.correlate((valid & each).astype(np.int8), beside.astype(np.int8), mode="constant")
        for each in (is_bright, ~is_bright)
    )
    dead = valid & (light <= 0) & (bright > 0) & (3 * dim <= bright)  # three in four are bright

    # The second brightest of the eight beside: half as far above at most one of them may be.
    second = ndimage.rank_filter(light, -2, footprint=beside, mode="constant", cval=-np.inf)
    hot = valid & (above > np.maximum(THRESHOLD * noise, HOT_EXCESS * np.maximum(median, 0)))
    hot &= second <= median + above / 2
    # Light of an edge reaches the pixels beside it: those of a defect are sound, or defects too.
    lit_too, candidates = median + np.maximum(above / 4, THRESHOLD * noise), 0
    while candidates != (candidates := int(hot.sum())):
        others = np.where(hot, -np.inf, light)
        brightest = ndimage.maximum_filter(others, footprint=beside, mode="constant", cval=-np.inf)
        hot &= brightest <= lit_too
    # The channel's noise may hide that of a place: texture makes its own pixels stand out.
    for row, column in np.argwhere(hot):
        window = slice(max(row - 2, 0), row + 3), slice(max(column - 2, 0), column + 3)
        near = valid[window].copy()
        near[row - window[0].start, column - window[1].start] = False
        hot[row, column] &= above[row, column] > THRESHOLD * _spread(
            light[window][near] - median[row, column]
        )
    return np.stack([dead, hot])


def _spread(deviations: Array) -> float:
    """Return the standard deviation of Gaussian noise with this median deviation, 0.6745 of it."""
    return 1.4826 * float(np.median(np.abs(deviations))) if deviations.size else 0.0
