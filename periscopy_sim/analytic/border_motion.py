"""How what a wall point sees of each patch changes as the scene moves: `patch_light`, derived.

The light that a shadow takes away changes where its border moves, by what shines there, and with
what shines within (Reynolds' transport theorem). The first is an integral along the shadow's
outline, of all parameters at once; the second, smooth, is the light's gradient with the border as
it is. Derivatives good to a percent would not do: of what each of a dozen parameters does a
hundredth may be all by which they differ.
"""

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
from periscopy_sim.analytic.patch_light import Lighting, falloff, gather, shadow_within
from periscopy_sim.hidden import GAUSS
from periscopy_sim.numerics import Array
from periscopy_sim.numerics.compilation import compiled, compiled_reordered

NUMBERS = 10
"""How many numbers the light of a wall point depends on: its place, normal, cells, exponents."""


@compiled
def light_derivatives(
    lit: Lighting,
    moved: Lighting,
    moved_vertices: Array,
    borders: Borders,
    shape: Indices,
    cut: Indices,
    out: NDArray[np.float32],
) -> None:
    """Fill `out`, (P, m, N), with derivatives of what `light_rows` fills, by P parameters.

    Parameters
    ----------
    lit, borders, shape, cut
        As there.
    moved, moved_vertices
        Derivatives, (P, ...), of `lit` and of the borders' vertices.
    """
    rows, columns = shape
    P, K = len(moved.points), lit.points.shape[1]
    changes = np.empty((rows, columns, P))  # parameters side by side: loops vectorize
    gradient, motions = np.empty((NUMBERS, rows, columns)), np.empty((NUMBERS, P))
    motions[6:8], motions[8:] = moved.cells.T, moved.exponents.T
    for i in range(len(lit.points)):
        changes[:] = 0
        for k in range(K):
            p, normal = lit.points[i, k], lit.normals[i, k]
            border, layers, between = border_of(p, borders, shape)
            segments = cut_by_cells(border, outline_of(border, layers, rows), shape)
            motion = _motion(p, borders.vertices, moved.points[:, i, k], moved_vertices, between)
            _move_border(p, normal, lit.cells, lit.exponents, border, segments, motion, changes)
            motions[:3], motions[3:6] = moved.points[:, i, k].T, moved.normals[:, i, k].T
            if motions.any():
                shadow = shadow_within(segments, shape)
                light_gradient(p, normal, lit.cells, lit.exponents, shadow, gradient)
                _add_products(gradient, motions, changes)
        out[:, i] = 0
        gather(changes, cut, 1 / K, out[:, i])


@compiled_reordered
def light_gradient(
    p: Array, normal: Array, cells: Array, exponents: Array, shadow: Array, out: Array
) -> None:
    """Fill `out`, (10, R, C), with the gradient of what `add_light` adds, at a given shadow.

    With x and y across and down from the point, h its height, D = x² + y² + h² and n its normal,
    light is (h/√(h² + x²))^e₁ (h/√(h² + y²))^e₀ h (n₀ x + n₁ y − n₂ h)/D². Rows 0 to 2 are its
    derivatives by the point, 3 to 5 by n, 6 and 7 by a cell's width and height, 8 and 9 by e₀ and
    e₁.
    """
    _, rows, columns = out.shape
    height, total = p[2], 1 + exponents[0] + exponents[1]
    x, across, bend, cosine = np.empty((4, 2, columns))
    for s in range(2):
        for c in range(columns):
            x[s, c] = (c + 0.5 + (GAUSS if s else -GAUSS) - p[0]) * cells[0]
            squared = x[s, c] * x[s, c] + height * height
            across[s, c] = falloff(x[s, c], height, exponents[1])
            bend[s, c], cosine[s, c] = exponents[1] / squared, np.log(height / np.sqrt(squared))
    out[:] = 0
    for k in range(2 * rows):
        side = GAUSS if k % 2 else -GAUSS
        y = (k // 2 + 0.5 + side - p[1]) * cells[1]
        squared, facing_y = y * y + height * height, normal[1] * y - normal[2] * height
        strength = falloff(y, height, exponents[0]) * height / 4
        bend_y, cosine_y = exponents[0] / squared, np.log(height / np.sqrt(squared))
        (area, aside, down), row = shadow[:, k // 2], out[:, k // 2]
        for s in range(2):
            tilt = 12 * GAUSS * (1 - 2 * s)
            for c in range(columns):
                lit = 1 - area[c] - 12 * side * down[c] + tilt * aside[c]
                distance = x[s, c] * x[s, c] + squared
                facing = normal[0] * x[s, c] + facing_y
                weight = lit * strength * across[s, c] / (distance * distance)
                weight = weight if facing > 0 else 0.0
                light, inverse = weight * facing, 4 / distance
                to_x = weight * normal[0] - light * x[s, c] * (bend[s, c] + inverse)
                to_y = weight * normal[1] - light * y * (bend_y + inverse)
                by_height = total / height - height * (bend[s, c] + bend_y + inverse)
                row[0, c] -= cells[0] * to_x
                row[1, c] -= cells[1] * to_y
                row[2, c] += light * by_height - weight * normal[2]
                row[3, c] += weight * x[s, c]
                row[4, c] += weight * y
                row[5, c] -= weight * height
                row[6, c] += to_x * x[s, c] / cells[0]
                row[7, c] += to_y * y / cells[1]
                row[8, c] += light * cosine_y
                row[9, c] += light * cosine[s, c]


@compiled_reordered
def _add_products(gradient: Array, motions: Array, out: Array) -> None:
    """Add to `out`, (R, C, P), a gradient, (10, R, C), times derivatives, (10, P)."""
    rows, columns, P = out.shape
    slopes = np.empty(NUMBERS)
    for r in range(rows):
        for c in range(columns):
            cell = out[r, c]
            slopes[:] = gradient[:, r, c]
            for q in range(P):
                for n in range(NUMBERS):  # a short loop, which is unrolled
                    cell[q] += slopes[n] * motions[n, q]


@compiled
def _motion(
    p: Array, vertices: Array, moved_p: Array, moved_vertices: Array, between: Indices
) -> Array:
    """Return derivatives, (n, 4, P), of the border's ends, as p and the vertices there move."""
    changes = np.empty((len(between), 4, len(moved_p)))
    for e in range(len(between)):
        for end in range(2):
            vertex = vertices[between[e, end]]
            # The end of an edge is p + stretch (vertex - p), where the line from p meets h = 0.
            above = p[2] - vertex[2]
            stretch = p[2] / above
            for q in range(len(moved_p)):
                moved = moved_vertices[q, between[e, end]]
                longer = (p[2] * moved[2] - moved_p[q, 2] * vertex[2]) / (above * above)
                for axis in range(2):
                    changes[e, 2 * end + axis, q] = (
                        moved_p[q, axis]
                        + longer * (vertex[axis] - p[axis])
                        + stretch * (moved[axis] - moved_p[q, axis])
                    )
    return changes


@compiled
def _move_border(
    p: Array,
    normal: Array,
    cells: Array,
    exponents: Array,
    border: Array,
    segments: list[Segment],
    motion: Array,
    out: Array,
) -> None:
    """Add to `out`, (R, C, P), the light over which the outline moves, cell by cell."""
    for e, sign, row, column, u, v, beside, below in segments:
        if column < 0:
            continue
        middle = (v + below) / 2
        light = sign * _light(p, normal, cells, exponents, (u + beside) / 2, middle)
        t = (middle - border[e, 1]) / (border[e, 3] - border[e, 1])
        down, across = light * (below - v), light * (beside - u)
        du0, dv0, du1, dv1 = motion[e]
        cell = out[row, column]
        for q in range(len(cell)):
            du, dv = du0[q] + t * (du1[q] - du0[q]), dv0[q] + t * (dv1[q] - dv0[q])
            cell[q] += down * du - across * dv


@compiled
def _light(p: Array, normal: Array, cells: Array, exponents: Array, u: float, v: float) -> float:
    """Return the light of a place of the monitor."""
    x, y, height = (u - p[0]) * cells[0], (v - p[1]) * cells[1], p[2]
    towards = max(normal[0] * x + normal[1] * y - normal[2] * height, 0.0)
    distance = x * x + y * y + height * height
    fall = falloff(x, height, exponents[1]) * falloff(y, height, exponents[0])
    return float(fall * height * towards / (distance * distance))
