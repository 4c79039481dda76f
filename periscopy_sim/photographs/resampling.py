"""Pixels of a photograph averaged to those of a scene's film, by the area that each covers.

Nothing is interpolated: noise of different new pixels stays independent but for the pixels on their
borders. A new pixel that any saturated or masked pixel enters is not used; averages leave out
single defective pixels.
"""

from typing import Any

import numpy as np
from numpy.typing import NDArray

from periscopy_sim.numerics import Array, Mask, machine
from periscopy_sim.numerics.products import compiled, compiled_reordered

SLIVER = 1e-6
"""Fraction of a new pixel's area that does not count: rounding of its corners."""

MOST_CORNERS = 16
"""Room for the corners of a clipped quadrilateral: each of four cuts adds one to a convex one, and
two to a crossed one."""

LEAST_MEASURED = 0.5
"""Fraction of a new pixel's area that sound pixels must cover."""


DEFECTIVE, EXCLUDED = 1, 2
"""States of a photograph's pixel that is not sound, 0: averages leave out the first; no new pixel
that the second enters is used."""


def block_corners(size: tuple[int, int], shape: tuple[int, int]) -> Array:
    """Return (rows + 1, columns + 1, 2) corners of the equal blocks of a photograph of a size."""
    row, column = (np.linspace(0, whole, n + 1) for whole, n in zip(size, shape, strict=True))
    return np.stack(np.meshgrid(column, row), axis=-1)


class AreaMap:
    """Quadrilaterals over which images of one size are averaged, pixels weighted by area in them.

    The areas are exact: every pixel clips each quadrilateral that it meets. The images' pixels have
    `states`, (height, width) uint8: `DEFECTIVE`, `EXCLUDED` or 0. `corners`, (rows + 1, columns +
    1, 2), are columns and rows in the images of the new pixels' corners; an image's first pixel
    reaches from 0 to 1. Each new pixel has a box of weights: the fractions of its sound area that
    the images' pixels cover.

    Attributes
    ----------
    usable
        (rows, columns) bool, new pixels within the images, without an excluded pixel, and of which
        sound pixels cover `LEAST_MEASURED`.
    """

    def __init__(self, states: NDArray[np.uint8], corners: Array) -> None:
        corners = np.ascontiguousarray(corners, dtype=np.float64)
        quads = np.stack([corners[:-1, :-1], corners[:-1, 1:], corners[1:, 1:], corners[1:, :-1]])
        most = np.array(states.shape[::-1])
        low, high = (np.clip(each, 0, most) for each in (quads.min(axis=0), quads.max(axis=0)))
        self._boxes = np.concatenate([np.floor(low), np.ceil(high)], axis=-1).astype(np.int64)
        sides = self._boxes[..., 2:] - self._boxes[..., :2]
        ends = np.cumsum(np.prod(sides, axis=-1))
        shape = sides.shape[:2]
        self._starts: NDArray[np.intp] = np.append(0, ends[:-1]).reshape(shape)
        self._weights = np.zeros(ends[-1], np.float32)
        excluded, covered = np.zeros(shape, bool), np.zeros((*shape, 2))

        def weigh(part: tuple[int, int]) -> None:
            boxes = self._boxes, self._starts, self._weights
            _weigh_rows(states, corners, part[0], part[1], *boxes, excluded, covered)

        machine.in_parallel(weigh, machine.ranges(shape[0]))
        least = [1 - SLIVER, LEAST_MEASURED]
        self.usable: Mask = ~excluded & (covered >= least).all(axis=2)

    def average(
        self, image: NDArray[Any], table: NDArray[np.float32] | None = None
    ) -> NDArray[Any]:
        """Return an image, (height, width, channels), averaged to (rows, columns, channels).

        `table` is the light of each code of the image, whose averages are float32; None for an
        image of light, whose averages are float64. Where a sound pixel is infinite, as saturated
        ones may be, the average is infinite; where there is no sound pixel, 0.
        """
        dtype: Any = np.float64 if table is None else np.float32
        values = np.empty((*self.usable.shape, image.shape[2]), dtype)
        image = np.ascontiguousarray(image)

        def average(part: tuple[int, int]) -> None:
            boxes = self._boxes, self._starts, self._weights
            _average_rows(image, table, part[0], part[1], *boxes, values)

        machine.in_parallel(average, machine.ranges(len(self.usable)))
        return values


@compiled
def _weigh_rows(
    states: NDArray[np.uint8],
    corners: Array,
    start: int,
    stop: int,
    boxes: NDArray[np.int64],
    starts: NDArray[np.int64],
    weights: NDArray[np.float32],
    excluded: Mask,
    covered: Array,
) -> None:
    """Fill the boxes of the new pixels in rows from start to stop, which hold zeros.

    `excluded` gets whether an excluded pixel is within them, `covered` the fractions of their areas
    that all pixels and that sound ones cover. The strip of a new pixel within a row of pixels is
    cut once, and each of its pixels out of the strip.
    """
    quad, (spare, strip, cell) = np.empty((4, 2)), np.empty((3, MOST_CORNERS, 2))
    for i in range(start, stop):
        for j in range(corners.shape[1] - 1):
            for axis in range(2):
                quad[0, axis], quad[1, axis] = corners[i, j, axis], corners[i, j + 1, axis]
                quad[2, axis], quad[3, axis] = corners[i + 1, j + 1, axis], corners[i + 1, j, axis]
            left, top, right, bottom = boxes[i, j]
            whole, inside, sound, k = _area(quad, 4), 0.0, 0.0, starts[i, j]
            for row in range(top, bottom):
                clipped = _clip(quad, 4, 1, float(row), 1.0, spare)
                clipped = _clip(spare, clipped, 1, row + 1.0, -1.0, strip)
                first, last = _span(strip, clipped, left, right)
                for column in range(first, last):
                    sides = _clip(strip, clipped, 0, float(column), 1.0, spare)
                    sides = _clip(spare, sides, 0, column + 1.0, -1.0, cell)
                    area = _area(cell, sides)
                    inside += area
                    if area <= SLIVER * whole:  # a pixel that rounding alone lets in
                        continue
                    excluded[i, j] |= states[row, column] == EXCLUDED
                    if states[row, column] == 0:
                        weights[k + column - left] = area
                        sound += area
                k += right - left
            if sound > 0:
                for m in range(starts[i, j], k):
                    weights[m] /= sound
            covered[i, j, 0], covered[i, j, 1] = inside / whole, sound / whole


@compiled_reordered
def _average_rows(
    image: NDArray[Any],
    table: NDArray[np.float32] | None,
    start: int,
    stop: int,
    boxes: NDArray[np.int64],
    starts: NDArray[np.int64],
    weights: NDArray[np.float32],
    values: NDArray[np.floating],
) -> None:
    """Average the new pixels in rows from start to stop; see `AreaMap.average`."""
    for i in range(start, stop):
        for j in range(boxes.shape[1]):
            left, top, right, bottom = boxes[i, j]
            for channel in range(image.shape[2]):
                total, k = values.dtype.type(0), starts[i, j]
                for row in range(top, bottom):
                    for column in range(left, right):
                        if weights[k] > 0:
                            code = image[row, column, channel]
                            total += weights[k] * (code if table is None else table[code])
                        k += 1
                values[i, j, channel] = total


@compiled
def _span(polygon: Array, sides: int, low: int, high: int) -> tuple[int, int]:
    """Return the first column from `low` to `high` that a polygon meets, and the one after."""
    if sides == 0:
        return low, low
    left = right = polygon[0, 0]
    for k in range(1, sides):
        left, right = min(left, polygon[k, 0]), max(right, polygon[k, 0])
    return int(np.floor(min(max(left, low), high))), int(np.ceil(min(max(right, low), high)))


@compiled
def _clip(polygon: Array, sides: int, axis: int, bound: float, sign: float, kept: Array) -> int:
    """Keep the part of a polygon beyond a grid line (Sutherland, Hodgman 1974); count its corners.

    That part has larger coordinates where `sign` is 1, smaller ones where it is -1.
    """
    count = 0
    for k in range(sides):
        following = k + 1 if k + 1 < sides else 0
        here = sign * (polygon[k, axis] - bound)
        there = sign * (polygon[following, axis] - bound)
        if here >= 0:
            kept[count, 0], kept[count, 1] = polygon[k, 0], polygon[k, 1]
            count += 1
        if (here > 0 and there < 0) or (here < 0 and there > 0):  # the side crosses the line
            part = here / (here - there)
            other = 1 - axis
            along = polygon[following, other] - polygon[k, other]
            kept[count, other] = polygon[k, other] + part * along
            kept[count, axis] = bound
            count += 1
    return count


@compiled
def _area(polygon: Array, sides: int) -> float:
    """Return the area of a polygon, by the shoelace formula about its first corner.

    Coordinates of thousands of pixels would cancel about the origin, where pixels measure 1.
    """
    twice = 0.0
    for k in range(1, sides - 1):
        ax, ay = polygon[k, 0] - polygon[0, 0], polygon[k, 1] - polygon[0, 1]
        bx, by = polygon[k + 1, 0] - polygon[0, 0], polygon[k + 1, 1] - polygon[0, 1]
        twice += ax * by - ay * bx
    return abs(twice) / 2
