"""Pixels of a photograph averaged to those of a scene's film, by blocks or by the area they cover.

Nothing is interpolated: noise of different new pixels stays independent but for the pixels on their
borders. Flaws are kept apart: where anything saturated or masked would enter, the new pixel is not
measured; single defective pixels are left out of the average.
"""

from __future__ import annotations

from dataclasses import dataclass
from enum import IntFlag

import numpy as np
from numpy.typing import NDArray

from periscopy_sim.numerics.compilation import compiled
from periscopy_sim.numerics.threads import in_parallel, ranges
from periscopy_sim.photographs.film.blocks import block_means

Array = NDArray[np.float64]
Mask = NDArray[np.bool_]

SLIVER = 1e-6
"""Part of a new pixel's area below which what it covers does not count: rounding of its corners."""

LEAST_MEASURED = 0.5
"""Part of a new pixel's area that sound pixels must cover."""


class Flaw(IntFlag):
    """Why a pixel of a photograph does not measure the wall's light."""

    SATURATED = 1
    MASKED = 2
    DEFECTIVE = 4


@dataclass(frozen=True, eq=False)
class Resampled:
    """A photograph in new pixels.

    Attributes
    ----------
    values
        (rows, columns, channels) float64; NaN where nothing sound is covered.
    covered
        (rows, columns) part of each new pixel that lies in the photograph.
    measured
        (rows, columns) part of each new pixel that sound pixels cover.
    flaws
        (rows, columns) uint8, the `Flaw`s within each new pixel.
    """

    values: Array
    covered: Array
    measured: Array
    flaws: NDArray[np.uint8]

    @property
    def outside(self) -> Mask:
        """(rows, columns) bool, new pixels that reach out of the photograph."""
        return np.asarray(self.covered < 1 - SLIVER)

    @property
    def used(self) -> Mask:
        """(rows, columns) bool, new pixels that measure the wall."""
        spoiled = (self.flaws & (Flaw.SATURATED | Flaw.MASKED)) != 0
        return np.asarray(~self.outside & ~spoiled & (self.measured >= LEAST_MEASURED))


def average_blocks(
    image: NDArray[np.floating], flaws: NDArray[np.uint8], shape: tuple[int, int]
) -> Resampled:
    """Return an image averaged over equal blocks of whole pixels.

    Parameters
    ----------
    image
        (k rows, l columns, channels) with whole numbers k and l.
    flaws
        (k rows, l columns) uint8 of `Flaw`.
    shape
        (rows, columns) of the result.
    """
    sound = (flaws == 0)[..., np.newaxis]
    measured = block_means(sound, shape)
    with np.errstate(invalid="ignore"):
        values = block_means(np.where(sound, image, 0), shape) / measured
    rows, columns = shape
    blocks = flaws.reshape(rows, flaws.shape[0] // rows, columns, flaws.shape[1] // columns)
    found = np.bitwise_or.reduce(np.bitwise_or.reduce(blocks, axis=3), axis=1)
    values[measured[..., 0] == 0] = np.nan
    return Resampled(values, np.ones(shape), measured[..., 0], found)


def average_quadrilaterals(
    image: NDArray[np.floating], flaws: NDArray[np.uint8], corners: Array
) -> Resampled:
    """Return an image averaged over quadrilaterals, each pixel weighted by the area in them.

    The areas are exact: each quadrilateral is clipped by every pixel that it meets.

    Parameters
    ----------
    image
        (height, width, channels), constant over each of its pixels.
    flaws
        (height, width) uint8 of `Flaw`.
    corners
        (rows + 1, columns + 1, 2) column and row in the image of the new pixels' corners, finite;
        the image's first pixel reaches from 0 to 1.
    """
    rows, columns = corners.shape[0] - 1, corners.shape[1] - 1
    image = np.ascontiguousarray(image, dtype=np.float32)
    values = np.zeros((rows, columns, image.shape[2]))
    covered, measured = np.zeros((rows, columns)), np.zeros((rows, columns))
    found = np.zeros((rows, columns), np.uint8)
    corners = np.ascontiguousarray(corners, dtype=np.float64)

    def average(part: tuple[int, int]) -> None:
        _average_rows(image, flaws, corners, *part, values, covered, measured, found)

    in_parallel(average, ranges(rows))
    return Resampled(values, covered, measured, found)


@compiled
def _average_rows(
    image: NDArray[np.float32],
    flaws: NDArray[np.uint8],
    corners: Array,
    start: int,
    stop: int,
    values: Array,
    covered: Array,
    measured: Array,
    found: NDArray[np.uint8],
) -> None:
    """Average what the new pixels in rows from start to stop cover."""
    height, width, channels = image.shape
    quad, strip = np.empty((4, 2)), np.empty((16, 2))
    cell, spare = np.empty((16, 2)), np.empty((16, 2))
    for i in range(start, stop):
        for j in range(corners.shape[1] - 1):
            for axis in range(2):
                quad[0, axis], quad[1, axis] = corners[i, j, axis], corners[i, j + 1, axis]
                quad[2, axis] = corners[i + 1, j + 1, axis]
                quad[3, axis] = corners[i + 1, j, axis]
            whole = _area(quad, 4)
            inside = sound = 0.0
            top, bottom = _span(quad, 4, 1, height)
            for row in range(top, bottom):
                clipped = _clip(quad, 4, 1, float(row), 1.0, spare)
                clipped = _clip(spare, clipped, 1, row + 1.0, -1.0, strip)
                left, right = _span(strip, clipped, 0, width)
                for column in range(left, right):
                    sides = _clip(strip, clipped, 0, float(column), 1.0, spare)
                    sides = _clip(spare, sides, 0, column + 1.0, -1.0, cell)
                    area = _area(cell, sides)
                    inside += area
                    if area <= SLIVER * whole:
                        continue
                    found[i, j] |= flaws[row, column]
                    if flaws[row, column] == 0:
                        sound += area
                        for channel in range(channels):
                            values[i, j, channel] += area * image[row, column, channel]
            values[i, j] /= sound  # NaN where there is none
            covered[i, j] = inside / whole
            measured[i, j] = sound / whole


@compiled
def _span(polygon: Array, sides: int, axis: int, count: int) -> tuple[int, int]:
    """Return the first pixel of `count` along an axis that a polygon meets, and the one after."""
    if sides == 0:
        return 0, 0
    low = high = polygon[0, axis]
    for k in range(1, sides):
        low, high = min(low, polygon[k, axis]), max(high, polygon[k, axis])
    low, high = min(max(low, 0.0), float(count)), min(max(high, 0.0), float(count))
    return int(np.floor(low)), int(np.ceil(high))


@compiled
def _clip(polygon: Array, sides: int, axis: int, bound: float, sign: float, kept: Array) -> int:
    """Keep what of a polygon lies on one side of a line along the grid (Sutherland, Hodgman 1974).

    The side is that of larger coordinates where `sign` is 1, of smaller ones where it is -1. The
    number of corners kept is returned.
    """
    count = 0
    for k in range(sides):
        following = k + 1 if k + 1 < sides else 0
        here = sign * (polygon[k, axis] - bound)
        there = sign * (polygon[following, axis] - bound)
        if here >= 0:
            kept[count, 0], kept[count, 1] = polygon[k, 0], polygon[k, 1]
            count += 1
        if (here > 0 and there < 0) or (here < 0 and there > 0):
            part = here / (here - there)
            other = 1 - axis
            along = polygon[following, other] - polygon[k, other]
            kept[count, other] = polygon[k, other] + part * along
            kept[count, axis] = bound
            count += 1
    return count


@compiled
def _area(polygon: Array, sides: int) -> float:
    """Return the area of a polygon, by the shoelace formula about its first corner."""
    twice = 0.0
    for k in range(1, sides - 1):
        ax, ay = polygon[k, 0] - polygon[0, 0], polygon[k, 1] - polygon[0, 1]
        bx, by = polygon[k + 1, 0] - polygon[0, 0], polygon[k + 1, 1] - polygon[0, 1]
        twice += ax * by - ay * bx
    return abs(twice) / 2
