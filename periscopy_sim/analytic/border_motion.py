"""How what a wall point sees of each patch changes as the scene moves: derivatives of `scanline`.

The light that a shadow takes away changes where its border moves, by what shines there, and with
what shines within (Reynolds' transport theorem). The first is summed where lines meet the border,
of all parameters at once; the second, smooth, is a difference with the border as it is. Differences
of areas themselves, in which the border moves, are good to a percent or so, by which the least that
a dozen parameters can change together would be overrated many times over.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from periscopy_sim.analytic.scanline import (
    Indices,
    add_unshadowed,
    border_of,
    cross,
    falloff,
    lines_across,
    remove_line,
    remove_shadow,
    sides,
    turns_about,
)
from periscopy_sim.numerics.compilation import compiled
from periscopy_sim.scenario import Array

PART = 1e-5
"""Of a parameter's move by which light within a border is differenced, in double precision."""

ASIDE = 1e-4
"""Of a row by which the light along a line is differenced."""


@compiled
def light_derivatives(
    points: Array,
    normals: Array,
    cells: Array,
    exponents: Array,
    moved_points: Array,
    moved_normals: Array,
    moved_cells: Array,
    moved_exponents: Array,
    moved_vertices: Array,
    shines: NDArray[np.bool_],
    vertices: Array,
    planes: Array,
    two_sided: NDArray[np.bool_],
    edges: Indices,
    starts: Indices,
    faces: Indices,
    signs: Indices,
    shape: Indices,
    out: NDArray[np.float32],
) -> None:
    """Fill `out`, (P, m, N), with derivatives of what `light_rows` fills, by P parameters.

    Parameters
    ----------
    points, normals, cells, exponents, vertices, planes, two_sided, edges, starts, faces, signs
        As there, as is `shape`.
    moved_points, moved_normals, moved_cells, moved_exponents, moved_vertices
        (P, ...) derivatives of each.
    shines
        (P,) whether a parameter moves any but the vertices.
    """
    count, patches = len(shines), shape[0] * shape[1]
    rows, still, near = np.empty((count, patches)), np.empty(patches), np.empty(patches)
    for i in range(points.shape[0]):
        rows[:] = 0
        for k in range(points.shape[1]):
            p, normal = points[i, k], normals[i, k]
            turns = turns_about(p, planes, two_sided, starts, faces, signs)
            border, layers, between = border_of(p, vertices, edges, turns, shape[0])
            lines, of_border = lines_across(border, shape) if len(border) else (
                np.empty(0), np.empty(0, np.int64)
            )  # fmt: skip
            if len(border):
                motion = _motion(p, vertices, moved_points[:, i, k], moved_vertices, between)
                _move_border(
                    p, normal, cells, exponents, border, layers, motion, lines, of_border, shape,
                    rows,
                )  # fmt: skip
            still[:] = 0
            if shines.any():
                add_unshadowed(p, normal, cells, exponents, shape, still)
                if len(border):
                    remove_shadow(p, normal, cells, exponents, border, layers, lines, shape, still)
            for q in range(count):
                if not shines[q]:
                    continue
                near[:] = 0
                place = p + PART * moved_points[q, i, k]
                facing = normal + PART * moved_normals[q, i, k]
                size, fall = cells + PART * moved_cells[q], exponents + PART * moved_exponents[q]
                add_unshadowed(place, facing, size, fall, shape, near)
                if len(border):
                    remove_shadow(place, facing, size, fall, border, layers, lines, shape, near)
                for j in range(patches):
                    rows[q, j] += (near[j] - still[j]) / PART
        for q in range(count):
            for j in range(patches):
                out[q, i, j] = rows[q, j] / points.shape[1]


@compiled
def _motion(
    p: Array, vertices: Array, moved_p: Array, moved_vertices: Array, between: Indices
) -> Array:
    """Return derivatives, (P, n, 4), of the border's ends, as p and the vertices there move."""
    found = np.empty((len(moved_p), len(between), 4))
    for e in range(len(between)):
        for end in range(2):
            vertex = vertices[between[e, end]]
            above = p[2] - vertex[2]
            stretch = p[2] / above
            for q in range(len(moved_p)):
                moved = moved_vertices[q, between[e, end]]
                longer = (p[2] * moved[2] - moved_p[q, 2] * vertex[2]) / (above * above)
                for axis in range(2):
                    found[q, e, 2 * end + axis] = (
                        moved_p[q, axis]
                        + longer * (vertex[axis] - p[axis])
                        + stretch * (moved[axis] - moved_p[q, axis])
                    )
    return found


@compiled
def _move_border(
    p: Array,
    normal: Array,
    cells: Array,
    exponents: Array,
    border: Array,
    layers: Indices,
    motion: Array,
    lines: Array,
    of_border: Indices,
    shape: Indices,
    out: Array,
) -> None:
    """Add to `out`, (P, N), what moves over the border, or with a line's ends, line by line."""
    columns, count = shape[1], len(motion)
    across = sides(p, cells, exponents, shape)
    crossings, crossed = np.empty(len(border)), np.empty(len(border), np.int64)
    here, below, drifts = np.empty(columns), np.empty(columns), np.zeros(count)
    for k in range(len(lines) - 1):
        thickness, v = lines[k + 1] - lines[k], (lines[k] + lines[k + 1]) / 2
        if thickness <= 0:
            continue
        n, first = cross(border, v, crossings, crossed), int(v) * columns
        moves = of_border[k] >= 0 or of_border[k + 1] >= 0
        drifts[:] = 0
        if moves:  # the line's own place and thickness change with its ends
            here[:], below[:] = 0, 0
            for place, taken in ((v, here), (v + ASIDE, below)):
                remove_line(
                    p, normal, cells, exponents, across, layers, crossings, crossed[:n],
                    place, thickness, taken,
                )  # fmt: skip
            for q in range(count):
                upper, lower = _end(motion, q, of_border[k]), _end(motion, q, of_border[k + 1])
                thicker, drifts[q] = (lower - upper) / thickness, (lower + upper) / 2
                if upper != 0 or lower != 0:
                    for c in range(columns):
                        darker = (below[c] - here[c]) / ASIDE
                        out[q, first + c] += thicker * here[c] + drifts[q] * darker
        before = 0
        for c in range(n):
            e, u = crossed[c], crossings[c]
            after = before + layers[e]
            entered = (1.0 if after != 0 else 0.0) - (1.0 if before != 0 else 0.0)
            before = after
            if entered == 0 or u <= 0 or u >= columns:
                continue
            u0, v0, u1, v1 = border[e]
            t, slope = (v - v0) / (v1 - v0), (u1 - u0) / (v1 - v0)
            light = entered * thickness * _light(p, normal, cells, exponents, u, v)
            for q in range(count):
                du0, dv0, du1, dv1 = motion[q, e]
                along = (1 - t) * (du0 - slope * dv0) + t * (du1 - slope * dv1)
                out[q, first + int(u)] += light * (along + slope * drifts[q])


@compiled
def _end(motion: Array, q: int, of_border: int) -> float:
    """Return how a line's end moves down: as an end of the border, or not."""
    return float(motion[q, of_border // 2, 2 * (of_border % 2) + 1]) if of_border >= 0 else 0.0


@compiled
def _light(p: Array, normal: Array, cells: Array, exponents: Array, u: float, v: float) -> float:
    """Return the light of a place of the monitor, as `scanline` has it."""
    x, y, height = (u - p[0]) * cells[0], (v - p[1]) * cells[1], p[2]
    towards = max(normal[0] * x + normal[1] * y - normal[2] * height, 0.0)
    distance = x * x + y * y + height * height
    fall = falloff(x, height, exponents[1]) * falloff(y, height, exponents[0])
    return float(fall * height * towards / (distance * distance))
