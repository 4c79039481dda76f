"""One picture, linear in light, from what a camera took of one view.

The black level or a dark frame is subtracted, photographs are averaged, and a flat field evens them
out.
"""

from collections.abc import Iterable, Iterator
from dataclasses import replace

import numpy as np
from numpy.typing import ArrayLike

from periscopy_sim.errors import PhotographError
from periscopy_sim.photographs.sensor_image import SensorImage, check_same_size, sensor_image


def develop(
    photographs: Iterable[SensorImage | ArrayLike],
    *,
    black: float = 0.0,
    dark: SensorImage | ArrayLike | None = None,
    flat: SensorImage | ArrayLike | None = None,
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
        A photograph of an evenly lit white surface, to divide by. Pixels where it is dark or
        saturated count as saturated.

    Raises
    ------
    PhotographError
        If sizes differ, or a value is not finite.
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
    return _evened(light, replace(even, values=even.values - offset))


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
    return SensorImage(total / np.float32(count), saturated, first.cell)


def _evened(exposure: SensorImage, flat: SensorImage) -> SensorImage:
    """Return an exposure divided by a flat field, whose channels are scaled to mean 1."""
    unfit = (flat.values <= 0).any(axis=2) | flat.saturated
    if unfit.all():
        raise PhotographError("the flat field: all of it is dark or saturated; expose it well")
    mean = flat.values[~unfit].mean(axis=0, dtype=np.float64)
    gain = np.where(unfit[..., np.newaxis], 1, flat.values / mean).astype(np.float32)
    return replace(exposure, values=exposure.values / gain, saturated=exposure.saturated | unfit)
