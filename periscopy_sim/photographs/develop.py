"""One linear picture from a camera's photographs of one view, without the pixels that err.

The black level or a dark frame is subtracted, photographs are averaged, and a flat field evens them
out.

Each channel is examined alone, and a pixel is defective if one of its channels is. All conditions
of a test must hold: noise or the wall itself may explain one of them. The numbers are those by
which tests/photographs/test_defects.py finds every planted defect, and none on sound walls.
"""

import warnings
from collections.abc import Iterable, Sequence
from dataclasses import dataclass, replace
from functools import reduce
from itertools import product
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from periscopy_sim.errors import PhotographError
from periscopy_sim.numerics import Array, Image, Mask, machine, validation
from periscopy_sim.photograph import Photograph, check_real, common_pixels, with_channels

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
    saturated, dead, hot = np.logical_or.reduce(machine.in_parallel(kinds_of, channels))
    return DefectivePixels(saturated, dead, hot & ~saturated)


def plateaus(photograph: NDArray[Any], name: str) -> list[str]:
    """Return a line about a plateau at the top of a photograph whose saturation nobody declares.

    The test is that of `defective_pixels`; a black level must not be subtracted unevenly before.
    """
    everywhere = np.ones(photograph.shape[:2], bool)
    channels = [
        _saturated(each, everywhere, *np.unique(each, return_counts=True))
        for each in np.moveaxis(photograph, -1, 0)
    ]
    if not (plateau := np.any(channels, axis=0)).any():
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
    edge = int(np.max(sides))
    inside = slice(edge, len(light) - edge)
    highest = [
        reduce(np.maximum, (light[edge + each : len(light) - edge + each] for each in side))
        for side in sides
    ]
    return edge + np.flatnonzero(np.minimum(*highest) < light[inside] - least)


def _medians(values: Array) -> Array:
    """Return the upper median of each row."""
    middle = values.shape[1] // 2
    return np.asarray(np.partition(values, middle, axis=1)[:, middle])


def gaussian_spread(deviations: Array) -> float:
    """Return the standard deviation of Gaussian noise with this median deviation; 0 of none."""
    return GAUSSIAN * float(np.median(np.abs(deviations))) if deviations.size else 0.0


LINES, BLOCKS = 256, 8
"""Rows and columns of pixels, at least, in which two photographs are compared, and of blocks."""

LEAST_CHANGE, BEYOND = 0.01, 5.0
"""Root mean square change of blocks that is no noise, over the light and over what white noise has:
noise alone has 1.3 of that at most in 600 draws. Pictures on a chair's wall differ by 0.04 to 0.14
of the light, at SBR 1 by 0.02 to 0.07."""


@dataclass(frozen=True, eq=False)
class SensorImage:
    """One picture, linear in light, and where its sensor was saturated.

    `cell` is the number of the sensor's pixels along each side of one pixel here: 2 for cells of a
    Bayer mosaic. Marks are in pixels of the sensor; masks may be.
    """

    values: NDArray[np.float32]  # (rows, columns, C)
    saturated: Mask  # (rows, columns), where a channel is saturated
    cell: int = 1

    @property
    def size(self) -> tuple[int, int]:
        """(rows, columns)."""
        rows, columns = self.saturated.shape
        return rows, columns

    @property
    def infinite(self) -> NDArray[np.float32]:
        """(rows, columns, C) values, infinite where the picture is saturated."""
        return np.where(self.saturated[..., np.newaxis], np.float32(np.inf), self.values)


def sensor_image(
    values: SensorImage | ArrayLike,
    name: str,
    white: float | None = None,
    saturated: Mask | None = None,
    cell: int = 1,
) -> SensorImage:
    """Return a picture, (rows, columns[, C]) linear in light, as a `SensorImage`.

    A `SensorImage` is returned as it is. Messages call the picture `name`. `white` is the value
    from which on a pixel is saturated. None: for integers the largest, if it is one less than a
    power of two, the end of a converter's range; else no value is. `saturated`, (rows, columns)
    bool, adds pixels. An array that is no picture, or holds NaN or infinity, is a PhotographError.
    """
    if isinstance(values, SensorImage):
        return values
    array = validation.plain_array(values, name)
    check_real(array.dtype, name)
    array = with_channels(array, name)
    with np.errstate(over="ignore", invalid="ignore"):
        light = array.astype(np.float32)
    if not light.size or not np.isfinite(light).all():
        raise PhotographError(f"{name}: has no pixels, or NaN or infinite values; replace them")
    if white is None:
        largest = int(array.max()) if array.dtype.kind in "iu" else 0
        # 2ⁿ - 1 has no bit in common with 2ⁿ.
        white = largest if largest >= 255 and largest & (largest + 1) == 0 else np.inf
    full = np.asarray((light >= white).any(axis=2))
    return SensorImage(light, full if saturated is None else full | saturated, cell)


def mask_of_pixels(mask: Mask, light: SensorImage) -> Mask:
    """Return a mask of a picture's pixels from one of its sensor's: all of a cell must be used."""
    rows, columns = light.size
    if light.cell > 1 and mask.shape == (light.cell * rows, light.cell * columns):
        return np.asarray(mask.reshape(rows, light.cell, columns, light.cell).all(axis=(1, 3)))
    check_same_size(mask.shape, light.size, "the mask")
    return mask


def check_same_size(shape: tuple[int, ...], wanted: tuple[int, ...], name: str) -> None:
    """Check that a picture is as large as its photograph, and has as many channels, if given."""
    if shape[:2] != wanted[:2]:
        raise PhotographError(
            f"{name}: {shape[0]} x {shape[1]} pixels (rows x columns), but the photograph has "
            f"{wanted[0]} x {wanted[1]}; give one of the same size"
        )
    if shape[2:] != wanted[2:]:
        raise PhotographError(
            f"{name}: {shape[2]} channels, but the photograph has {wanted[2]}; give one of the "
            "same camera"
        )


def develop(
    photographs: Iterable[SensorImage | ArrayLike],
    *,
    black: float = 0.0,
    dark: SensorImage | ArrayLike | None = None,
    flat: SensorImage | ArrayLike | None = None,
) -> SensorImage:
    """Return one linear picture from a camera's photographs of one view.

    Parameters
    ----------
    photographs
        (rows, columns, C) each, of one exposure time; they are averaged.
    black
        The camera's black level, subtracted from every photograph and the flat field.
    dark
        A photograph with the lens covered, subtracted likewise. Give one of the two.
    flat
        A photograph of an evenly lit white surface, to divide by. Pixels where it is dark or
        saturated count as saturated.
    """
    if dark is not None and black:
        raise PhotographError("a dark frame holds the black level; give one of the two")
    if not abs(black) < validation.LIGHT_RANGE[1]:
        raise PhotographError(f"the black level is {black:g}; give a finite count")
    exposures = (sensor_image(each, f"photograph {k}") for k, each in enumerate(photographs))
    light, offset = average(exposures, "photographs"), np.asarray(black, np.float32)
    if dark is not None:
        darkness = sensor_image(dark, "the dark frame")
        check_same_size(darkness.values.shape, light.values.shape, "the dark frame")
        offset = darkness.values
        light = replace(light, saturated=light.saturated | darkness.saturated)
    light = replace(light, values=light.values - offset)
    if flat is not None:
        even = sensor_image(flat, "the flat field")
        check_same_size(even.values.shape, light.values.shape, "the flat field")
        bright = even.values - offset
        unfit = (bright <= 0).any(axis=2) | even.saturated
        if unfit.all():
            raise PhotographError("the flat field: all of it is dark or saturated; expose it well")
        # light / (flat / mean flat): the lens's falloff goes, the channels' levels stay.
        mean = bright[~unfit].mean(axis=0, dtype=np.float64)  # of each channel
        gain = np.where(unfit[..., np.newaxis], 1, bright / mean).astype(np.float32)
        with np.errstate(over="ignore"):
            values = light.values / gain
        light = replace(light, values=values, saturated=light.saturated | unfit)
    if not np.isfinite(light.values).all():
        raise PhotographError("developed values are not finite; check the levels, dark and flat")
    return light


def average(exposures: Iterable[SensorImage], name: str) -> SensorImage:
    """Return the mean of exposures of one view and time, saturated where any of them is.

    Leaving out single saturated values would favour those that noise made darker.
    """
    exposures = iter(exposures)
    first = next(exposures, None)
    if first is None:
        raise PhotographError(f"{name}: there is none; give one at least")
    total, saturated, count, change = first.values.copy(), first.saturated.copy(), 1, 0.0
    for each in exposures:
        check_same_size(each.values.shape, first.values.shape, name)
        used = ~(first.saturated | each.saturated)
        change = max(change, change_beyond_noise(first.values, each.values, used))
        total += each.values
        saturated |= each.saturated
        count += 1
    if change:
        line = f"{name}: averaged, though {differing(change)}"
        warnings.warn(line, RuntimeWarning, stacklevel=2)
    return SensorImage(total / np.float32(count), saturated, first.cell)


def change_beyond_noise(before: Image, after: Image, used: Mask) -> float:
    """Return by which fraction two photographs' light differs; 0 where their noise may explain it.

    It is the root mean square over `BLOCKS` of pixels, once both have one brightness.
    """
    step = max(1, min(used.shape) // LINES)
    first, other, used = before[::step, ::step], after[::step, ::step], used[::step, ::step]
    pairs = used[:, 1:] & used[:, :-1]
    if not pairs.any() or min(levels := [each[used].mean() for each in (first, other)]) <= 0:
        return 0.0
    light = (
        np.where(used, each.mean(axis=2), 0) for each in (first / levels[0], other / levels[1])
    )
    change = np.subtract(*light)
    noise = gaussian_spread(np.diff(change, axis=1)[pairs]) / np.sqrt(2)
    edges = [np.arange(min(BLOCKS, n)) * n // min(BLOCKS, n) for n in used.shape]
    sums, counts = (
        np.add.reduceat(np.add.reduceat(each, edges[0], axis=0), edges[1], axis=1)
        for each in (change, used.astype(float))
    )
    means, counts = sums[counts > 0] / counts[counts > 0], counts[counts > 0]
    rms = float(np.sqrt(np.mean(means**2)))
    return rms if rms > max(LEAST_CHANGE, BEYOND * noise * np.sqrt(np.mean(1 / counts))) else 0.0


def differing(change: float) -> str:
    """Return in words that photographs differ, by `change_beyond_noise`, and what to do."""
    return (
        f"they differ by {100 * change:.2g} % of their light, more than noise does: average "
        "photographs of one still picture by a camera at rest"
    )
