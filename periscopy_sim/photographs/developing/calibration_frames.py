"""Whether a dark frame, a flat field and a black level can be a photograph's own."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from periscopy_sim.errors import PhotographError
from periscopy_sim.photographs.developing.sensor_image import Mask, SensorImage

BELOW = 0.02
"""Part of the pixels below the black level from which that is told; of a well exposed photograph
none is."""

BLOCKS = 16
"""Parts of a frame, down and across, whose means are compared."""

ALIKE = 0.9
"""Correlation of a dark frame's means with a photograph's from which it shows the same view."""

DEEP = 0.01
"""Least contrast of these means over the photograph's: less does no harm."""

BRIGHT = 0.1
"""The same, from which a frame is not dark, whatever it shows: honest ones had 1e-4 at most."""

SIGNIFICANT = 10.0
"""Variance of a dark frame's means over what noise alone gives them."""


def check_another_frame(frame: SensorImage, photograph: SensorImage, name: str) -> None:
    """Refuse a dark frame or flat field, as `name` calls it, that is the photograph itself."""
    if frame.size == photograph.size and np.array_equal(frame.values, photograph.values):
        raise PhotographError(
            f"{name}: is the photograph itself; give another file, or leave it out"
        )


def black_level_doubt(light: SensorImage, mask: Mask | None, by: str) -> str:
    """Return that a black level, which was taken off light, is too high; empty where it is not.

    `by` is what told it, as in messages; the mask is True where the photograph is used. A
    PhotographError says that nothing of the photograph is above it.
    """
    least = light.values.min(axis=2)
    part = float(np.mean((least if mask is None else least[mask]) < 0))
    if part == 1:
        raise PhotographError(f"all pixels are below the black level; check {by}")
    if part < BELOW:
        return ""
    return f"{100 * part:.0f} % of the pixels are below the black level; check {by}"


def dark_frame_doubt(dark: SensorImage, photograph: SensorImage) -> str:
    """Return that a dark frame is not dark, or shows what the photograph shows; else nothing.

    Both are as the camera gave them. Means of their parts are compared, which keep little noise.
    """
    rows, columns = (size // BLOCKS for size in dark.size)
    if dark.size != photograph.size or min(rows, columns) < 2:
        return ""

    def parts(frame: SensorImage) -> NDArray[np.float64]:
        whole = frame.values[: BLOCKS * rows, : BLOCKS * columns].mean(axis=2, dtype=np.float64)
        blocks = whole.reshape(BLOCKS, rows, BLOCKS, columns)
        return np.asarray(np.moveaxis(blocks, 2, 1).reshape(BLOCKS**2, -1))

    own, seen = parts(dark), parts(photograph)
    # Single hot pixels are no view: the median of a part does not see them.
    means, light = np.median(own, axis=1), seen.mean(axis=1)
    noise = np.median(own.var(axis=1)) * np.pi / 2 / own.shape[1]
    contrast, whole = float(means.std()), float(light.std())
    if not (whole > 0 and contrast > DEEP * whole and contrast**2 > SIGNIFICANT * noise):
        return ""
    alike = np.corrcoef(means, light)[0, 1] > ALIKE
    if not alike and contrast < BRIGHT * whole:
        return ""
    shows = "shows what the photograph shows" if alike else "is not dark all over"
    return f"{shows}; take it with the lens covered, at the same exposure time"
