"""One picture, linear in light, of what a camera took of one view."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import replace

import numpy as np
from numpy.typing import ArrayLike, NDArray

from periscopy_sim.errors import PhotographError
from periscopy_sim.photographs.developing.calibration_frames import check_another_frame
from periscopy_sim.photographs.developing.exposures import (
    average,
    evenly_sensitive,
    merge,
    without_offset,
)
from periscopy_sim.photographs.developing.sensor_image import (
    Mask,
    SensorImage,
    as_sensor_image,
    check_same_size,
)


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
        The camera's black level, taken off every photograph and the flat field.
    dark
        A photograph with the lens covered, taken off likewise. Give one of the two.
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
    offset: NDArray[np.float32] | float = black
    spoiled: Mask | bool = False
    frames: list[tuple[SensorImage, str]] = []
    if dark is not None:
        if black:
            raise PhotographError("a dark frame holds the black level; give one of the two")
        darkness = as_sensor_image(dark, "the dark frame")
        offset, spoiled = darkness.values, darkness.saturated
        frames.append((darkness, "the dark frame"))
    if flat is not None:
        even = as_sensor_image(flat, "the flat field")
        frames.append((even, "the flat field"))

    def taken() -> Iterable[SensorImage]:
        for k, each in enumerate(photographs):
            exposure = as_sensor_image(each, f"photograph {k}")
            for frame, name in frames:
                check_another_frame(frame, exposure, name)
            if not np.isscalar(offset):
                check_same_size(np.shape(offset)[:2], exposure.size, "the dark frame")
            exposure = replace(exposure, saturated=exposure.saturated | spoiled)
            yield without_offset(exposure, offset)

    light = average(taken(), "photographs") if times is None else merge(list(taken()), times)
    if flat is None:
        return light
    check_same_size(even.size, light.size, "the flat field")
    even = without_offset(even, offset)
    return evenly_sensitive(light, even, mask)
