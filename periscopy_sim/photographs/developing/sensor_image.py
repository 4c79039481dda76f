"""One picture of a sensor: linear in light, and where it was saturated.

A camera's counts are linear in light above its black level and below its saturation. Arrays are of
single precision, which holds the counts of every sensor exactly: photographs may be large.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike, NDArray

from periscopy_sim.errors import PhotographError
from periscopy_sim.photograph import check_real, with_channels

Mask = NDArray[np.bool_]

_LEAST_CODE = 255


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
    saturated: Mask
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
    saturated: Mask | None = None,
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


def as_sensor_image(given: SensorImage | ArrayLike, name: str) -> SensorImage:
    """Return what is a `SensorImage` as it is, and arrays as one; see `sensor_image`."""
    return given if isinstance(given, SensorImage) else sensor_image(given, name)


def mask_of_pixels(mask: Mask, light: SensorImage) -> Mask:
    """Return a mask of a photograph's pixels from one of its sensor's; one of another size fails.

    Of a cell of a mosaic, all pixels must be used.
    """
    rows, columns = light.size
    on_sensor = light.cell * rows, light.cell * columns
    if light.cell > 1 and mask.shape == on_sensor:
        cells = mask.reshape(rows, light.cell, columns, light.cell)
        return np.asarray(cells.all(axis=(1, 3)))
    remedy = "draw it on the photograph, or on the prepared one of the film's size"
    check_same_size(mask.shape, light.size, "the mask", remedy)
    return mask


def check_same_size(
    size: tuple[int, ...],
    wanted: tuple[int, ...],
    name: str,
    remedy: str = "take it with the same camera and settings",
) -> None:
    """Refuse a picture that is not as large as the photograph it belongs to."""
    if tuple(size) != tuple(wanted):
        raise PhotographError(
            f"{name}: {size[0]} x {size[1]} pixels (rows x columns), but the photograph has "
            f"{wanted[0]} x {wanted[1]}; {remedy}"
        )
