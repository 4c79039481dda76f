"""Exposures of one view: black level and dark frame taken off, averaged or merged, made even."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from periscopy_sim.errors import PhotographError
from periscopy_sim.photographs.developing.sensor_image import SensorImage, check_same_size

FILLED = 0.95
"""Part of the saturation that a longer exposure may fill where it is merged with shorter ones."""


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
