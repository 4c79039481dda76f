"""Exposures of one view: black level and dark frame taken off, averaged or merged, made even.

A camera's counts are linear in light above its black level and below its saturation. Arrays are of
single precision, which holds the counts of every sensor exactly: photographs may be large.
"""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import ArrayLike, NDArray

from periscopy_sim.errors import PhotographError
from periscopy_sim.photographs.checking import check_real, with_channels

_LEAST_CODE = 255

FILLED = 0.95
"""Part of the saturation that a longer exposure may fill where it is merged with shorter ones."""


@dataclass(frozen=True, eq=False)
class SensorImage:
    """One picture, linear in light, and where its sensor was saturated.

    Attributes
    ----------
    values
        (rows, columns, 3) float32.
    saturated
        (rows, columns) bool, where a channel is.
    white
        The least value at which a channel is saturated; infinite if that is not known.
    cell
        Pixels of the sensor along each side of one of these: 2 where cells of a Bayer mosaic were
        made pixels. Places in the photograph, and masks, may be those of the sensor.
    """

    values: NDArray[np.float32]
    saturated: NDArray[np.bool_]
    white: float = np.inf
    cell: int = 1

    @property
    def size(self) -> tuple[int, int]:
        """(rows, columns)."""
        rows, columns = self.saturated.shape
        return rows, columns


def sensor_image(
    values: ArrayLike,
    name: str,
    white: float | None = None,
    saturated: NDArray[np.bool_] | None = None,
    cell: int = 1,
) -> SensorImage:
    """Return a picture as a `SensorImage`.

    Parameters
    ----------
    values
        (rows, columns), (rows, columns, 1) or (rows, columns, 3), linear in light.
    name
        What messages call it.
    white
        The value from which on a pixel is saturated. None: of integers the largest, if that is one
        less than a power of two, as of a converter's range that is used up; else no value is.
    saturated
        (rows, columns) bool, where else they are.
    cell
        See `SensorImage`.

    Raises
    ------
    PhotographError
        If it is no picture, or holds NaN or infinity.
    """
    array = np.asarray(values)
    check_real(array.dtype, name)
    array = with_channels(array, name)
    if not array.size:
        raise PhotographError(f"{name}: has no pixels; give a picture")
    with np.errstate(over="ignore", invalid="ignore"):
        light = np.repeat(array.astype(np.float32), 3 // array.shape[2], axis=2)
    if not np.isfinite(light).all():
        raise PhotographError(f"{name}: holds NaN or infinite values; replace them")
    if white is None:
        white = _top_code(array) if array.dtype.kind in "iu" else np.inf
    full = np.asarray((light >= white).any(axis=2))
    if saturated is not None and saturated.any():
        full |= saturated
        white = min(white, float(light[saturated].max(axis=1).min()))
    return SensorImage(light, full, white, cell)


def _top_code(counts: NDArray[np.integer]) -> float:
    """Return the largest of a converter's codes, if the counts reach it, else infinity."""
    largest = int(counts.max())
    return float(largest) if largest >= _LEAST_CODE and largest & (largest + 1) == 0 else np.inf


def average(exposures: Iterable[SensorImage], name: str) -> SensorImage:
    """Return the mean of exposures of one view and time; saturated is what any of them has so.

    Leaving out single saturated values would favour those that noise made darker. `name` is what
    messages call them.
    """
    total, saturated, white, count, cell = None, None, np.inf, 0, 1
    for each in exposures:
        if total is None or saturated is None:
            total, saturated = each.values.astype(np.float32), each.saturated.copy()
        else:
            check_same_size(each.size, saturated.shape, name)
            total += each.values
            saturated |= each.saturated
        white, count, cell = min(white, each.white), count + 1, each.cell
    if total is None or saturated is None:
        raise PhotographError(f"{name}: there is none; give one at least")
    total /= count
    return SensorImage(total, saturated, white, cell)


def merge(exposures: Sequence[SensorImage], times: Sequence[float]) -> SensorImage:
    """Return light per unit of time from exposures of different times, black levels taken off.

    Each value is the sum of counts over the sum of times, which Poisson noise makes the best
    estimate, of the exposures that are not saturated there. Whether a longer one is, is judged by
    what the shorter ones measured in the pixels around: it joins where that would fill at most
    `FILLED` of its range. Judged by the pixel's own values, an exposure would be left out where
    noise made it bright, and kept where it made it dark.

    Parameters
    ----------
    exposures
        Of one view and size; what is saturated in the shortest is saturated in the result.
    times
        Of each, positive, in any unit.
    """
    if len(times) != len(exposures) or not all(0 < time < np.inf for time in times):
        raise PhotographError(
            f"{len(exposures)} exposures, but {len(times)} positive times; give one for each"
        )
    order = np.argsort(times, kind="stable")
    shortest, *longer = (exposures[k] for k in order)
    first, *rest = (np.float32(times[k]) for k in order)
    counts = shortest.values.astype(np.float32)
    duration = np.full(counts.shape, first, np.float32)
    for each, time in zip(longer, rest, strict=True):
        check_same_size(each.size, shortest.size, "exposures")
        expected = time * _around(counts / duration)
        joins = ~each.saturated[..., np.newaxis] & (expected < FILLED * each.white)
        counts += np.where(joins, each.values, 0)
        duration += np.where(joins, time, np.float32(0))
    light, white = counts / duration, shortest.white / float(first)
    return SensorImage(light, shortest.saturated, white, shortest.cell)


def _around(light: NDArray[np.float32]) -> NDArray[np.float32]:
    """Return the mean of the 24 values around each, without its own; at the border of fewer."""
    from scipy.ndimage import uniform_filter

    square = uniform_filter(light, (5, 5, 1), mode="nearest")
    return np.asarray((25 * square - light) / 24)


def without_offset(exposure: SensorImage, offset: NDArray[np.float32] | float) -> SensorImage:
    """Return an exposure with its black level or dark frame, (rows, columns, 3), taken off."""
    typical = float(np.median(offset))  # single hot pixels of a dark frame say nothing of the range
    return replace(exposure, values=exposure.values - offset, white=exposure.white - typical)


def evenly_sensitive(
    exposure: SensorImage, flat: SensorImage, used: NDArray[np.bool_] | None = None
) -> SensorImage:
    """Return an exposure divided by a flat field, whose channels are scaled to mean 1.

    So vignetting and the pixels' own sensitivity go, and the mean light of an even picture stays.

    Parameters
    ----------
    exposure, flat
        With their black level or dark frame taken off. The flat field is a picture of an evenly lit
        white surface, by the same lens at the same aperture and focus.
    used
        (rows, columns) bool, where the flat field must have light; None: everywhere. Elsewhere the
        exposure stays as it is.

    Raises
    ------
    PhotographError
        If the flat field is not positive somewhere, saturated, or of another size.
    """
    check_same_size(flat.size, exposure.size, "the flat field")
    used = np.ones(flat.size, bool) if used is None else used
    dark = used & (flat.values <= 0).any(axis=2)
    for wrong, what in ((dark, "not positive"), (used & flat.saturated, "saturated")):
        if wrong.any():
            row, column = np.argwhere(wrong)[0]
            raise PhotographError(
                f"the flat field: {np.count_nonzero(wrong)} pixels are {what}, the first in row "
                f"{row}, column {column}; expose it well, or leave them out by a mask"
            )
    mean = flat.values[used].mean(axis=0, dtype=np.float64)
    gain = np.where(used[..., np.newaxis], flat.values / mean, 1).astype(np.float32)
    return replace(exposure, values=exposure.values / gain)


def check_same_size(size: tuple[int, ...], wanted: tuple[int, ...], name: str) -> None:
    """Refuse a picture that is not as large as the photograph it belongs to."""
    if tuple(size) != tuple(wanted):
        raise PhotographError(
            f"{name}: {size[0]} x {size[1]} pixels (rows x columns), but the photograph has "
            f"{wanted[0]} x {wanted[1]}; take it with the same camera and settings"
        )
