"""How what a wall point sees of each patch changes as the scene moves: `patch_light`, derived.

The light that a shadow takes away changes where its border moves, by what shines there, and with
what shines within (Reynolds' transport theorem). The first is an integral along the shadow's
outline, of all parameters at once; the second, smooth, is a difference with the border as it is.
Derivatives good to a percent would not do: of what each of a dozen parameters does a hundredth may
be all by which they differ.
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
from periscopy_sim.analytic.patch_light import Lighting, add_light, falloff, gather, shadow_within
from periscopy_sim.numerics import Array
from periscopy_sim.numerics.compilation import compiled

PART = float(np.cbrt(np.finfo(np.float64).eps))
"""Of a parameter's move by which light within a border is differenced, in double precision."""


@compiled
def light_derivatives(
    lit: Lighting,
    moved: Lighting,
    moved_vertices: Array,
    shines: NDArray[np.bool_],
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
    shines
        (P,) whether a parameter moves any but the vertices.
    """
    rows, columns = shape
    changes = np.empty((rows, columns, len(shines)))  # parameters side by side: loops vectorize
    still, smooth = np.empty((rows, columns)), np.empty((len(shines), rows, columns))
    cells, exponents = lit.cells, lit.exponents
    for i in range(len(lit.points)):
        changes[:] = 0
        smooth[:] = 0
        for k in range(lit.points.shape[1]):
            p, normal = lit.points[i, k], lit.normals[i, k]
            border, layers, between = border_of(p, borders, shape)
            segments = cut_by_cells(border, outline_of(border, layers, rows), shape)
            motion = _motion(p, borders.vertices, moved.points[:, i, k], moved_vertices, between)
            _move_border(p, normal, cells, exponents, border, segments, motion, changes)
            if not shines.any():
                continue
            shadow = shadow_within(segments, shape)
            still[:] = 0
            add_light(p, normal, cells, exponents, shadow, still)
            for q in range(len(shines)):
                if not shines[q]:
                    continue
                place = p + PART * moved.points[q, i, k]
                facing = normal + PART * moved.normals[q, i, k]
                size, fall = cells + PART * moved.cells[q], exponents + PART * moved.exponents[q]
                add_light(place, facing, size, fall, shadow, smooth[q])
                smooth[q] -= still
        scale = 1 / lit.points.shape[1]
        out[:, i] = 0
        gather(changes, cut, scale, out[:, i])
        for q in range(len(shines)):
            if shines[q]:
                light = smooth[q].reshape((rows, columns, 1))
                gather(light, cut, scale / PART, out[q : q + 1, i])


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
