"""What a wall point sees of the monitor, patch by patch: areas, no rays.

Patches are cut into cells, so small that light is all but linear over each. The outline
then gives the shadow's area and centroid within a cell, as in a rasterizer:
each segment adds what lies to its right, in its own cell and in all that follow.

Coordinates are those of `outline`; a cell's own begin at its middle. Light is in units of ρ/π times
a patch's area.
"""

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from periscopy_sim.analytic.outline import (
    Borders,
    Indices,
    Segment,
    border_of,
    cut_by_cells,
    outline_of,
)
from periscopy_sim.hidden import GAUSS
from periscopy_sim.numerics import Array
from periscopy_sim.numerics.compilation import compiled, compiled_reordered


class Lighting(NamedTuple):  # which compiled functions take
    """Wall points before a monitor, K for each of m pixels; or derivatives, (P, ...), of each."""

    points: Array  # (m, K, 3), (u, v, h)
    normals: Array  # (m, K, 3), the wall's, of unit length, along the same axes
    cells: Array  # (2,) a cell's width and height in metres
    exponents: Array  # (2,) of the cosines of the monitor's vertical and horizontal angles


@compiled
def light_rows(
    lit: Lighting, borders: Borders, shape: Indices, cut: Indices, out: NDArray[np.float32]
) -> None:
    """Fill `out`, (m, N), with the mean light of each patch at each pixel's K wall points.

    Parameters
    ----------
    lit, borders
        The wall's points before the monitor, and the occluders between.
    shape, cut
        (2,) rows and columns of all cells, and of the cells of a patch.
    """
    light = np.empty((shape[0], shape[1]))
    for i in range(len(lit.points)):
        light[:] = 0
        for k in range(lit.points.shape[1]):
            p = lit.points[i, k]
            border, layers, _ = border_of(p, borders, shape)
            segments = cut_by_cells(border, outline_of(border, layers, shape[0]), shape)
            shadow = shadow_within(segments, shape)
            add_light(p, lit.normals[i, k], lit.cells, lit.exponents, shadow, light)
        out[i] = 0
        gather(light.reshape((shape[0], shape[1], 1)), cut, 1 / lit.points.shape[1], out[i : i + 1])


@compiled
def shadow_within(segments: list[Segment], shape: Indices) -> Array:
    """Return the area, (3, R, C), of each cell that is in shadow, and its moments in u and v."""
    rows, columns = shape
    shadow, right_of = np.zeros((3, rows, columns)), np.zeros((2, rows, columns + 1))
    for _, sign, row, column, u, v, beside, below in segments:
        height, middle = sign * (below - v), (v + below) / 2 - row - 0.5
        right_of[0, row, column + 1] += height
        right_of[1, row, column + 1] += height * middle
        if column >= 0:
            a, b = u - column - 0.5, beside - column - 0.5
            width = 0.5 - (a + b) / 2
            shadow[0, row, column] += height * width
            shadow[1, row, column] += height * (0.125 - (a * a + a * b + b * b) / 6)
            shadow[2, row, column] += height * (middle * width - (below - v) * (b - a) / 12)
    for row in range(rows):
        area = moment = 0.0
        for c in range(columns):
            area += right_of[0, row, c]
            moment += right_of[1, row, c]
            shadow[0, row, c] += area
            shadow[2, row, c] += moment
    return shadow


@compiled_reordered
def add_light(
    p: Array, normal: Array, cells: Array, exponents: Array, shadow: Array, out: Array
) -> None:
    """Add each cell's light, but for what is in shadow, by two Gauss points along either axis."""
    rows, columns = out.shape
    height = p[2]
    x, across, light = np.empty((3, 2, columns))  # of each cell's left and right Gauss point
    for h in range(2):
        for c in range(columns):
            x[h, c] = (c + 0.5 + (GAUSS if h else -GAUSS) - p[0]) * cells[0]
            across[h, c] = falloff(x[h, c], height, exponents[1])
    left, right = light
    for k in range(2 * rows):
        side = GAUSS if k % 2 else -GAUSS
        y = (k // 2 + 0.5 + side - p[1]) * cells[1]
        strength = falloff(y, height, exponents[0]) * height / 4
        ahead = normal[1] * y - normal[2] * height
        squared = y * y + height * height
        for h in range(2):
            for c in range(columns):
                distance = x[h, c] * x[h, c] + squared
                towards = max(normal[0] * x[h, c] + ahead, 0.0)
                light[h, c] = strength * across[h, c] * towards / (distance * distance)
        area, aside, down = shadow[:, k // 2]
        row = out[k // 2]
        for c in range(columns):
            # What the line through the Gauss points' values has as its integral over the shadow.
            lit, tilt = 1 - area[c] - 12 * side * down[c], 12 * GAUSS * aside[c]
            row[c] += left[c] * (lit + tilt) + right[c] * (lit - tilt)


@compiled
def falloff(aside: float, height: float, exponent: float) -> float:
    """Return a power of the cosine of an angle of the monitor."""
    cosine, whole = height / np.sqrt(height * height + aside * aside), int(exponent)
    return float(cosine**whole if whole == exponent else cosine**exponent)  # whole: half the time


@compiled
def gather(light: Array, cut: Indices, scale: float, out: NDArray[np.float32]) -> None:
    """Add the mean of each patch's cells, of (R, C, P), times a number, to `out`, (P, N)."""
    columns = light.shape[1] // cut[1]
    scale /= cut[0] * cut[1]
    for q in range(len(out)):
        for r in range(light.shape[0]):
            row = out[q, r // cut[0] * columns : (r // cut[0] + 1) * columns]
            for c in range(cut[1]):
                for j in range(columns):
                    row[j] += scale * light[r, j * cut[1] + c, q]
