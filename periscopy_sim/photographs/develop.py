"""One linear picture from a camera's photographs of one view.

The black level or a dark frame is subtracted, photographs are averaged, and a flat field evens them
out.
"""

import warnings
from collections.abc import Iterable
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import ArrayLike, NDArray

from periscopy_sim.errors import PhotographError
from periscopy_sim.numerics import Image, Mask
from periscopy_sim.numerics.validation import LIGHT_RANGE, plain_array
from periscopy_sim.photograph import check_real, with_channels
from periscopy_sim.photographs.defects import gaussian_spread

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
    array = plain_array(values, name)
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
    if not abs(black) < LIGHT_RANGE[1]:
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
