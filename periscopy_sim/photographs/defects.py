"""Detection of pixels that do not measure light in one photograph: saturated, dead and hot ones.

Each channel is examined alone, and a pixel is defective if one of its channels is. All conditions
of a test must hold: noise or the wall itself may explain one of them. The numbers are those by
which tests/photographs/test_defects.py finds every planted defect, and none on sound walls.
"""

from collections.abc import Sequence
from dataclasses import dataclass
from functools import reduce
from itertools import product
from typing import Any

import numpy as np
from numpy.typing import NDArray

from periscopy_sim.numerics import Array, Mask
from periscopy_sim.numerics.machine import in_parallel
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

NOISE_PIXELS = 2**18
"""Pixels, at least, that show a channel's noise to 0.3 %."""

GAUSSIAN = 1.4826
"""Standard deviation of Gaussian noise over its median absolute deviation."""

BLOCK = 2**16
"""Pixels that are compared at a time."""

AROUND = sorted(product(range(-2, 3), repeat=2), key=lambda step: max(map(abs, step)))[1:]
"""Rows and columns from a pixel to the 24 around it, the 8 beside it first."""


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

    def kinds_of(light: NDArray[Any]) -> NDArray[np.bool_]:
        channel = np.asarray(light, np.float64)
        valid = np.isfinite(channel) & used
        kinds = np.zeros((3, *channel.shape), bool)
        if valid.any():
            levels = np.unique(channel[valid], return_counts=True)
            kinds[0] = _saturated(channel, valid, *levels)
            kinds[1:] = _dead_and_hot(channel, valid, levels[0])
        return kinds

    channels = list(np.moveaxis(values, -1, 0))
    saturated, dead, hot = np.logical_or.reduce(in_parallel(kinds_of, channels))
    return DefectivePixels(saturated, dead, hot & ~saturated)


def saturated_pixels(photograph: NDArray[Any]) -> Mask:
    """Return where a finite (rows, columns, channels) photograph is saturated.

    The test is that of `defective_pixels`; a black level must not be subtracted unevenly before.
    """
    everywhere = np.ones(photograph.shape[:2], bool)
    channels = [
        _saturated(each, everywhere, *np.unique(each, return_counts=True))
        for each in np.moveaxis(photograph, -1, 0)
    ]
    return np.asarray(np.any(channels, axis=0))


def plateaus(photograph: NDArray[Any], name: str) -> list[str]:
    """Return a line about a plateau at the top of a photograph whose saturation nobody declares."""
    if not (plateau := saturated_pixels(photograph)).any():
        return []
    top = photograph[plateau].max(axis=1).min()
    return [
        f"{name}: {np.count_nonzero(plateau)} pixels end in a plateau at {top:.6g}; if they are "
        "saturated, name this value as white"
    ]


def _saturated(
    channel: NDArray[Any], valid: Mask, levels: NDArray[Any], counts: NDArray[np.intp]
) -> Mask:
    """Return the saturated pixels of a channel, by its sorted levels and how often each occurs."""
    if len(levels) <= LEVELS or counts[-1] < PLATEAU:
        return np.zeros(channel.shape, bool)
    is_detached = levels[-1] - levels[-2] > DETACHED_GAP * (levels[-1] - levels[0])
    is_plateau = is_detached or counts[-1] > 1.5 * counts[-9:-1].sum()
    return np.asarray(valid & (channel == levels[-1]) & is_plateau)


def _dead_and_hot(channel: Array, valid: Mask, levels: Array) -> NDArray[np.bool_]:
    """Return the dead and the hot pixels of a channel, (2, rows, columns), some of it valid."""
    if not valid.all():
        from scipy.ndimage import distance_transform_edt

        # What is not valid shows the nearest valid pixel: its own value must move no median.
        nearest = distance_transform_edt(~valid, return_distances=False, return_indices=True)
        channel = channel[tuple(nearest)]
    # A frame keeps the pixels around each one within the arrays.
    framed = np.pad(channel, 2, mode="reflect")
    light, inside = framed.ravel(), np.pad(valid, 2).ravel()
    shown = np.pad(channel, 2, constant_values=-np.inf).ravel()
    around = np.array([i * framed.shape[1] + j for i, j in AROUND])
    beside = around[:8]

    measured = np.flatnonzero(inside & (light > 0))
    if not len(measured):  # black cut off at zero shows no noise
        measured = np.flatnonzero(inside)
    few = measured[:: max(1, len(measured) // NOISE_PIXELS)]
    level = float(np.median(light[few]))
    steps = np.diff(levels)
    step = float(steps.min(initial=np.inf))
    # Steps of quantization hide noise that is smaller than they are; steps above the level are no
    # quantization but a picture of a few values.
    noise = gaussian_spread(light[few] - _medians(light[few[:, np.newaxis] + around]))
    noise += step if len(steps) > 1 and step <= level else 0.0

    black, lit = np.flatnonzero(inside & (light <= 0)), max(THRESHOLD * noise, 0.1 * level)
    bright, dim = np.zeros((2, len(black)), np.int8)
    for near in (black + each for each in beside):
        bright += inside[near] & (light[near] > lit)
        dim += inside[near] & (light[near] <= lit)
    dead = black[(bright > 0) & (3 * dim <= bright)]  # three in four are bright

    # At most one pixel beside a hot one is half as far above, so those of one half are darker.
    hot = _peaks(shown, np.split(beside, 2), THRESHOLD * noise / 2)
    hot = hot[inside[hot]]
    median = _medians(light[hot[:, np.newaxis] + around])
    above = light[hot] - median
    second = np.sort(shown[hot[:, np.newaxis] + beside], axis=1)[:, -2]
    is_hot = above > np.maximum(THRESHOLD * noise, HOT_EXCESS * np.maximum(median, 0))
    is_hot &= second <= median + above / 2
    # Light of an edge reaches the pixels beside it: those of a defect are sound, or defects too.
    candidates, count = np.zeros(len(light), bool), -1
    while count != (count := int(is_hot.sum())):
        candidates[hot] = is_hot
        sides = hot[:, np.newaxis] + beside
        brightest = np.where(candidates[sides], -np.inf, shown[sides]).max(axis=1)
        is_hot &= brightest <= median + np.maximum(above / 4, THRESHOLD * noise)
    # The channel's noise may hide that of a place: texture makes its own pixels stand out.
    for k in np.flatnonzero(is_hot):
        near = hot[k] + around
        texture = gaussian_spread(light[near[inside[near]]] - median[k])
        is_hot[k] = above[k] > THRESHOLD * texture

    defects = np.zeros((2, len(light)), bool)
    defects[0, dead] = defects[1, hot[is_hot]] = True
    return defects.reshape(2, *framed.shape)[:, 2:-2, 2:-2]


def _peaks(light: Array, sides: Sequence[NDArray[np.intp]], least: float) -> NDArray[np.intp]:
    """Return the places of light that exceeds all of one side, or of the other, by `least`."""
    edge, places = int(np.max(sides)), []
    for start in range(edge, len(light) - edge, BLOCK):  # whole arrays would not stay in the cache
        stop = min(start + BLOCK, len(light) - edge)
        highest = [
            reduce(np.maximum, (light[start + each : stop + each] for each in side))
            for side in sides
        ]
        exceeds = np.minimum(*highest) < light[start:stop] - least
        places.append(start + np.flatnonzero(exceeds))
    return np.concatenate(places)


def _medians(values: Array) -> Array:
    """Return the upper median of each row."""
    middle = values.shape[1] // 2
    return np.asarray(np.partition(values, middle, axis=1)[:, middle])


def gaussian_spread(deviations: Array) -> float:
    """Return the standard deviation of Gaussian noise with this median deviation; 0 of none."""
    return GAUSSIAN * float(np.median(np.abs(deviations))) if deviations.size else 0.0
