"""One picture, linear in light, from what a camera took of one view.

The black level or a dark frame is subtracted, exposures are averaged or merged, and a flat field
evens them out.
"""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import replace

import numpy as np
from numpy.typing import ArrayLike, NDArray

from periscopy_sim.errors import PhotographError
from periscopy_sim.photograph import Mask, used_pixels
from periscopy_sim.photographs.sensor_image import SensorImage, check_same_size, sensor_image

FILLED = 0.95
"""Fraction of the saturation that a longer exposure may fill where it is merged."""

BELOW = 0.02
"""Fraction of pixels below the black level that causes a warning; well exposed ones have none."""


def develop(
    photographs: Iterable[SensorImage | ArrayLike],
    *,
    times: Sequence[float] | None = None,
    black: float = 0.0,
    dark: SensorImage | ArrayLike | None = None,
    flat: SensorImage | ArrayLike | None = None,
    mask: Mask | None = None,
) -> SensorImage:
    """Return one picture, linear in light, from what a camera took of one view.

    Parameters
    ----------
    photographs
        (rows, columns, 3) each. They are averaged; with `times` they are merged.
    times
        Exposure time of each, in any unit; the result is light per unit of time.
    black
        The camera's black level, subtracted from every photograph and the flat field.
    dark
        A photograph with the lens covered, subtracted likewise. Give one of the two.
    flat
        A photograph of an evenly lit white surface, to divide by.
    mask
        (rows, columns) bool, where the wall is used; elsewhere the flat field may be dark.

    Raises
    ------
    PhotographError
        If sizes differ, a value is not finite, the flat field is dark or saturated, or it or the
        dark frame is one of the photographs.
    """
    if dark is not None and black:
        raise PhotographError("a dark frame holds the black level; give one of the two")
    darkness = None if dark is None else sensor_image(dark, "the dark frame")
    even = None if flat is None else sensor_image(flat, "the flat field")
    frames = [(f, n) for f, n in ((darkness, "the dark frame"), (even, "the flat field")) if f]
    offset = black if darkness is None else darkness.values

    def exposures() -> Iterable[SensorImage]:
        for k, each in enumerate(photographs):
            exposure = sensor_image(each, f"photograph {k}")
            for frame, name in frames:
                check_same_size(frame.size, exposure.size, name)
                if np.array_equal(frame.values, exposure.values):
                    raise PhotographError(f"{name}: is the photograph itself; give another file")
            if darkness is not None:
                exposure = replace(exposure, saturated=exposure.saturated | darkness.saturated)
            yield _without_offset(exposure, offset)

    light = average(exposures(), "photographs") if times is None else merge(exposures(), times)
    return light if even is None else _evened(light, _without_offset(even, offset), mask)


def average(exposures: Iterable[SensorImage], name: str) -> SensorImage:
    """Return the mean of exposures of one view and time, saturated where any of them is.

    Leaving out single saturated values would favour those that noise made darker.
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


def merge(exposures: Iterable[SensorImage], times: Sequence[float]) -> SensorImage:
    """Return light per unit of time from exposures of different times, black levels subtracted.

    Each value is the sum of counts over the sum of times, the best estimate under Poisson noise, of
    the exposures that are not saturated there. A longer exposure joins where the mean of the pixels
    around, in the shorter ones, would fill at most `FILLED` of its range. The pixel's own value
    would exclude an exposure where noise made it bright, and keep it where noise made it dark. The
    exposures are of one view and size, the times positive, in any unit; what is saturated in the
    shortest exposure is saturated in the result.
    """
    from scipy.ndimage import uniform_filter

    exposures = list(exposures)
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
        light = counts / duration
        around = (25 * uniform_filter(light, (5, 5, 1), mode="nearest") - light) / 24
        joins = ~each.saturated[..., np.newaxis] & (time * around < FILLED * each.white)
        counts += np.where(joins, each.values, 0)
        duration += np.where(joins, time, np.float32(0))
    white = shortest.white / float(first)
    return SensorImage(counts / duration, shortest.saturated, white, shortest.cell)


def black_level_warning(light: SensorImage, mask: Mask | None, source: str) -> str:
    """Return a warning that the black level, already subtracted, is too high; empty if it is not.

    A PhotographError says that no pixel is above. Messages call the black level `source`.
    """
    below = float(np.mean(used_pixels(light.values, mask).min(axis=-1) < 0))
    if below == 1:
        raise PhotographError(f"all pixels are below the black level; check {source}")
    warning = f"{100 * below:.0f} % of the pixels are below the black level; check {source}"
    return warning if below >= BELOW else ""


def _without_offset(exposure: SensorImage, offset: NDArray[np.float32] | float) -> SensorImage:
    """Return an exposure less its black level or dark frame, (rows, columns, 3)."""
    typical = float(np.median(offset))  # single hot pixels of a dark frame do not limit the range
    return replace(exposure, values=exposure.values - offset, white=exposure.white - typical)


def _evened(exposure: SensorImage, flat: SensorImage, mask: Mask | None) -> SensorImage:
    """Return an exposure divided by a flat field, whose channels are scaled to mean 1.

    Both lack their offsets. Outside the mask the exposure stays as it is.
    """
    check_same_size(flat.size, exposure.size, "the flat field")
    used = np.ones(flat.size, bool) if mask is None else mask
    unfit = used & ((flat.values <= 0).any(axis=2) | flat.saturated)
    if unfit.any():
        row, column = np.argwhere(unfit)[0]
        raise PhotographError(
            f"the flat field: {np.count_nonzero(unfit)} pixels are not positive or saturated, the "
            f"first in row {row}, column {column}; expose it well, or leave them out by a mask"
        )
    mean = flat.values[used].mean(axis=0, dtype=np.float64)
    gain = np.where(used[..., np.newaxis], flat.values / mean, 1).astype(np.float32)
    return replace(exposure, values=exposure.values / gain)
