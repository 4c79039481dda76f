"""Pixels of a photograph averaged to those of a scene's film, by the area that each covers.

Nothing is interpolated: noise of different new pixels stays independent but for the pixels on their
borders. A new pixel that any saturated or masked pixel enters is not used; averages leave out
single defective pixels.
"""

from enum import IntFlag

import numpy as np
from numpy.typing import NDArray

from periscopy_sim.numerics import Array
from periscopy_sim.numerics.compilation import compiled, compiled_reordered
from periscopy_sim.numerics.machine import in_parallel, ranges

SLIVER = 1e-6
"""Fraction of a new pixel's area that does not count: rounding of its corners."""

MOST_CORNERS = 16
"""Room for the corners of a clipped quadrilateral: each of four cuts adds one to a convex one, and
two to a crossed one."""

LEAST_MEASURED = 0.5
"""Fraction of a new pixel's area that sound pixels must cover."""


class Flaw(IntFlag):
    """Why a pixel does not measure the wall's light."""

    SATURATED = 1
    MASKED = 2
    DEFECTIVE = 4
    """A dead or hot pixel; a new pixel with one is used."""
    OUTSIDE = 8
    """A new pixel that reaches out of the photograph."""
    TAG = 16
    """A new pixel beneath a tag's paper."""
    SPARSE = 32
    """A new pixel of which sound pixels cover less than `LEAST_MEASURED`."""


def block_corners(size: tuple[int, int], shape: tuple[int, int]) -> Array:
    """Return (rows + 1, columns + 1, 2) corners of the equal blocks of a photograph of a size."""
    row, column = (np.linspace(0, whole, n + 1) for whole, n in zip(size, shape, strict=True))
    return np.stack(np.meshgrid(column, row), axis=-1)


def average_areas(
    image: NDArray[np.floating], flaws: NDArray[np.uint8], corners: Array
) -> tuple[Array, NDArray[np.uint8]]:
    """Return an image averaged over quadrilaterals, each pixel weighted by its area in them.

    The areas are exact: every pixel clips each quadrilateral that it meets. The image is (height,
    width, channels), constant over each of its pixels, with `flaws`, (height, width) uint8 of
    `Flaw`. `corners`, (rows + 1, columns + 1, 2), are columns and rows in the image of the new
    pixels' corners; the image's first pixel reaches from 0 to 1. Return (rows, columns, channels)
    values, NaN where a new pixel covers no sound pixel, and (rows, columns) uint8, the flaws within
    each new pixel and its own.
    """
    rows, columns = corners.shape[0] - 1, corners.shape[1] - 1
    image = np.ascontiguousarray(image, dtype=np.float32)
    corners = np.ascontiguousarray(corners, dtype=np.float64)
    values = np.zeros((rows, columns, image.shape[2]))
    kinds, covered = np.zeros((rows, columns), np.uint8), np.zeros((rows, columns, 2))
    in_parallel(
        lambda part: _average_rows(image, flaws, corners, *part, values, kinds, covered),
        ranges(rows),
    )
    kinds |= np.uint8(Flaw.OUTSIDE) * (covered[..., 0] < 1 - SLIVER)
    kinds |= np.uint8(Flaw.SPARSE) * (covered[..., 1] < LEAST_MEASURED)
    return values, kinds


class AreaMap:
    """The areas of `average_areas`, computed once for many images of one size, as a video has them.

    `flaws` and `corners` are those of `average_areas`. Each new pixel has a box of weights: the
    fractions of its sound area that the image's pixels cover. `kinds`, (rows, columns), are the
    flaws within each new pixel and its own.
    """

    def __init__(self, flaws: NDArray[np.uint8], corners: Array) -> None:
        corners = np.ascontiguousarray(corners, dtype=np.float64)
        black = np.zeros((*flaws.shape, 1), np.float32)
        self.size: tuple[int, ...] = flaws.shape
        self.kinds = average_areas(black, flaws, corners)[1]
        quads = np.stack([corners[:-1, :-1], corners[:-1, 1:], corners[1:, 1:], corners[1:, :-1]])
        most = np.array(flaws.shape[::-1])
        low, high = (np.clip(each, 0, most) for each in (quads.min(axis=0), quads.max(axis=0)))
        self._boxes = np.concatenate([np.floor(low), np.ceil(high)], axis=-1).astype(np.int64)
        sides = self._boxes[..., 2:] - self._boxes[..., :2]
        ends = np.cumsum(np.prod(sides, axis=-1))
        self._starts: NDArray[np.intp] = np.append(0, ends[:-1]).reshape(sides.shape[:2])
        self._weights = np.zeros(ends[-1], np.float32)
        in_parallel(
            lambda part: _weigh_rows(
                flaws, corners, *part, self._boxes, self._starts, self._weights
            ),
            ranges(len(sides)),
        )

    def average(
        self, codes: NDArray[np.unsignedinteger], table: NDArray[np.float32], white: int
    ) -> tuple[NDArray[np.float32], NDArray[np.bool_]]:
        """Return an image of codes averaged as light, and where it is saturated.

        `codes` are (height, width, channels), `table` is the light of each code, and codes from
        `white` on are saturated. Return (rows, columns, channels) light, 0 where a new pixel covers
        no sound pixel, and (rows, columns) bool, True where a pixel that counts is saturated.
        """
        shape = self.kinds.shape
        values = np.empty((*shape, codes.shape[-1]), np.float32)
        full = np.empty(shape, np.bool_)
        codes = np.ascontiguousarray(codes)
        in_parallel(
            lambda part: _average_codes(
                codes, table, white, *part, self._boxes, self._starts, self._weights, values, full
            ),
            ranges(shape[0]),
        )
        return values, full


@compiled
def _weigh_rows(
    flaws: NDArray[np.uint8],
    corners: Array,
    start: int,
    stop: int,
    boxes: NDArray[np.int64],
    starts: NDArray[np.int64],
    weights: NDArray[np.float32],
) -> None:
    """Fill the boxes of the new pixels in rows from start to stop."""
    quad, (spare, strip, cell) = np.empty((4, 2)), np.empty((3, MOST_CORNERS, 2))
    for i in range(start, stop):
        for j in range(corners.shape[1] - 1):
            quad[0], quad[1] = corners[i, j], corners[i, j + 1]
            quad[2], quad[3] = corners[i + 1, j + 1], corners[i + 1, j]
            left, top, right, bottom = boxes[i, j]
            sliver, sound, k = SLIVER * _area(quad, 4), 0.0, starts[i, j]
            for row in range(top, bottom):
                clipped = _clip(quad, 4, 1, float(row), 1.0, spare)
                clipped = _clip(spare, clipped, 1, row + 1.0, -1.0, strip)
                for column in range(left, right):
                    sides = _clip(strip, clipped, 0, float(column), 1.0, spare)
                    sides = _clip(spare, sides, 0, column + 1.0, -1.0, cell)
                    area = _area(cell, sides)
                    if area > sliver and flaws[row, column] == 0:
                        weights[k] = area
                        sound += area
                    k += 1
            if sound > 0:
                weights[starts[i, j] : k] /= sound


@compiled_reordered
def _average_codes(
    codes: NDArray[np.unsignedinteger],
    table: NDArray[np.float32],
    white: int,
    start: int,
    stop: int,
    boxes: NDArray[np.int64],
    starts: NDArray[np.int64],
    weights: NDArray[np.float32],
    values: NDArray[np.float32],
    full: NDArray[np.bool_],
) -> None:
    """Average the new pixels in rows from start to stop."""
    channels = codes.shape[2]
    for i in range(start, stop):
        for j in range(boxes.shape[1]):
            left, top, right, bottom = boxes[i, j]
            for channel in range(channels):
                total, largest, k = np.float32(0), 0, starts[i, j]
                for row in range(top, bottom):
                    for column in range(left, right):
                        code = codes[row, column, channel]
                        total += weights[k] * table[code]
                        if weights[k] > 0:
                            largest = max(largest, code)
                        k += 1
                values[i, j, channel] = total
                full[i, j] = (full[i, j] and channel > 0) or largest >= white


@compiled
def _average_rows(
    image: NDArray[np.float32],
    flaws: NDArray[np.uint8],
    corners: Array,
    start: int,
    stop: int,
    values: Array,
    kinds: NDArray[np.uint8],
    covered: Array,
) -> None:
    """Average what the new pixels in rows from start to stop cover.

    `covered` gets the fractions of their areas that all pixels and that sound ones cover.
    """
    quad, scratch = np.empty((4, 2)), np.empty((3, MOST_CORNERS, 2))
    for i in range(start, stop):
        for j in range(corners.shape[1] - 1):
            quad[0], quad[1] = corners[i, j], corners[i, j + 1]
            quad[2], quad[3] = corners[i + 1, j + 1], corners[i + 1, j]
            whole = _area(quad, 4)
            kinds[i, j], inside, sound = _add_pixels(
                image, flaws, quad, SLIVER * whole, values[i, j], scratch
            )
            values[i, j] /= sound  # NaN where there is none
            covered[i, j, 0], covered[i, j, 1] = inside / whole, sound / whole


@compiled
def _add_pixels(
    image: NDArray[np.float32],
    flaws: NDArray[np.uint8],
    quad: Array,
    sliver: float,
    values: Array,
    scratch: Array,
) -> tuple[int, float, float]:
    """Add the sound pixels within a quadrilateral to `values`, (channels,), times their areas.

    Return the flaws of all pixels within, and the areas of all and of the sound ones. The strip of
    the quadrilateral within a row of pixels is cut once, and each of its pixels out of the strip.
    """
    spare, strip, cell = scratch
    kinds, inside, sound = 0, 0.0, 0.0
    top, bottom = _span(quad, 4, 1, image.shape[0])
    for row in range(top, bottom):
        clipped = _clip(quad, 4, 1, float(row), 1.0, spare)
        clipped = _clip(spare, clipped, 1, row + 1.0, -1.0, strip)
        left, right = _span(strip, clipped, 0, image.shape[1])
        for column in range(left, right):
            sides = _clip(strip, clipped, 0, float(column), 1.0, spare)
            sides = _clip(spare, sides, 0, column + 1.0, -1.0, cell)
            area = _area(cell, sides)
            inside += area
            if area <= sliver:  # a flaw that rounding alone lets in does not count
                continue
            kinds |= flaws[row, column]
            if flaws[row, column] == 0:
                sound += area
                for channel in range(len(values)):
                    values[channel] += area * image[row, column, channel]
    return kinds, inside, sound


@compiled
def _span(polygon: Array, sides: int, axis: int, count: int) -> tuple[int, int]:
    """Return the first pixel of `count` along an axis that a polygon meets, and the one after."""
    if sides == 0:
        return 0, 0
    low, high = polygon[:sides, axis].min(), polygon[:sides, axis].max()
    return int(np.floor(min(max(low, 0.0), count))), int(np.ceil(min(max(high, 0.0), count)))


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
