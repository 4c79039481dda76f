"""One picture, linear in light, from what a camera took of one view.

The black level or a dark frame is subtracted, photographs are averaged, and a flat field evens them
out.
"""

from __future__ import annotations

from collections.abc import Iterable, Iterator
from dataclasses import replace

import numpy as np
from numpy.typing import ArrayLike

from periscopy_sim.errors import PhotographError
from periscopy_sim.photograph import Mask, used_pixels
from periscopy_sim.photographs.sensor_image import SensorImage, check_same_size, sensor_image

BELOW = 0.02
"""Fraction of pixels below the black level that causes a warning; well exposed ones have none."""


def develop(
    photographs: Iterable[SensorImage | ArrayLike],
    *,
    black: float = 0.0,
    dark: SensorImage | ArrayLike | None = None,
    flat: SensorImage | ArrayLike | None = None,
    mask: Mask | None = None,
) -> SensorImage:
    """Return one picture, linear in light, from what a camera took of one view.

    Parameters
    ----------
    photographs
        (rows, columns, 3) each, of one exposure time; they are averaged.
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
        If sizes differ, a value is not finite, or the flat field is dark or saturated.
    """
    if dark is not None and black:
        raise PhotographError("a dark frame holds the black level; give one of the two")
    darkness = None if dark is None else sensor_image(dark, "the dark frame")
    offset = black if darkness is None else darkness.values

    def exposures() -> Iterator[SensorImage]:
        for k, each in enumerate(photographs):
            exposure = sensor_image(each, f"photograph {k}")
            if darkness is not None:
                check_same_size(darkness.size, exposure.size, "the dark frame")
                exposure = replace(exposure, saturated=exposure.saturated | darkness.saturated)
            yield replace(exposure, values=exposure.values - offset)

    light = average(exposures(), "photographs")
    if flat is None:
        return light
    even = sensor_image(flat, "the flat field")
    check_same_size(even.size, light.size, "the flat field")
    return _evened(light, replace(even, values=even.values - offset), mask)


def average(exposures: Iterable[SensorImage], name: str) -> SensorImage:
    """Return the mean of exposures of one view and time, saturated where any of them is.

    Leaving out single saturated values would favour those that noise made darker.
    """
    exposures = iter(exposures)
    first = next(exposures, None)
    if first is None:
        raise PhotographError(f"{name}: there is none; give one at least")
    total, saturated, count = first.values.copy(), first.saturated.copy(), 1
    for each in exposures:
        check_same_size(each.size, first.size, name)
        total += each.values
        saturated |= each.saturated
        count += 1
    return SensorImage(total / count, saturated, first.cell)


def black_level_warning(light: SensorImage, mask: Mask | None, source: str) -> str:
    """Return a warning that the black level, already subtracted, is too high; empty if it is not.

    A PhotographError says that no pixel is above. Messages call the black level `source`.
    """
    below = float(np.mean(used_pixels(light.values, mask).min(axis=-1) < 0))
    if below == 1:
        raise PhotographError(f"all pixels are below the black level; check {source}")
    warning = f"{100 * below:.0f} % of the pixels are below the black level; check {source}"
    return warning if below >= BELOW else ""


def _evened(exposure: SensorImage, flat: SensorImage, mask: Mask | None) -> SensorImage:
    """Return an exposure divided by a flat field, whose channels are scaled to mean 1.

    Both lack their offsets. Outside the mask the exposure stays as it is.
    """
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
