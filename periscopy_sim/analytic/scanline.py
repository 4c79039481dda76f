"""What a wall point sees of the monitor, patch by patch: areas, no rays.

A wall point p projects the occluders onto the monitor's plane, where the edges of `borders` bound
their shadow. Lines across the monitor are walked from border to border, counting how many layers
lie before p (the nonzero winding rule: Foley, van Dam, Feiner, Hughes, Computer Graphics, 1990,
Sec. 19.5.2); where there is one, the light of that piece is missing. Rows of patches are cut into
lines also where edges that run along them begin and end, so that what a line stands for changes
smoothly with the scene.

Coordinates are the monitor's: u in columns of patches from the left, v in rows from the top, and h,
the height above its plane, in metres. Light is in units of ρ/π times a patch's area.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from periscopy_sim.numerics.compilation import compiled, compiled_reordered
from periscopy_sim.scenario import Array

Indices = NDArray[np.int64]

LINES = 120
"""Lines across the monitor, at least: with four times as many, A of the chair changes by 1e-3."""

ALONG = 0.5
"""Rows by which an edge rises over a column of patches, below which lines end where it does."""

GAUSS = 0.5 / np.sqrt(3.0)
"""From a patch's middle to either of Gauss and Legendre's two points, in patches."""


@compiled
def light_rows(
    points: Array,
    normals: Array,
    cells: Array,
    exponents: Array,
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
    """Fill `out`, (m, N), with the mean light of each patch at each pixel's K wall points.

    Parameters
    ----------
    points, normals
        (m, K, 3) wall points (u, v, h), and the wall's unit normals there along the same axes.
    cells
        (2,) a patch's width and height in metres.
    exponents
        (2,) of the cosines of the monitor's vertical and horizontal angles.
    vertices, planes, two_sided, edges, starts, faces, signs
        Of the occluders, see `Borders`.
    shape
        (R, C).
    """
    row = np.empty(shape[0] * shape[1])
    for i in range(len(points)):
        row[:] = 0
        for k in range(points.shape[1]):
            p, normal = points[i, k], normals[i, k]
            add_unshadowed(p, normal, cells, exponents, shape, row)
            turns = turns_about(p, planes, two_sided, starts, faces, signs)
            border, layers, _ = border_of(p, vertices, edges, turns, shape[0])
            if len(border):
                lines, _ = lines_across(border, shape)
                remove_shadow(p, normal, cells, exponents, border, layers, lines, shape, row)
        for j in range(len(row)):
            out[i, j] = row[j] / points.shape[1]


@compiled_reordered
def add_unshadowed(
    p: Array, normal: Array, cells: Array, exponents: Array, shape: Indices, out: Array
) -> None:
    """Add the light of each patch that nothing shadows, by two Gauss points along either axis."""
    rows, columns = shape
    height = p[2]
    x, across, light = np.empty(2 * columns), np.empty(2 * columns), np.empty(2 * columns)
    for k in range(2 * columns):
        x[k] = (k // 2 + 0.5 + (GAUSS if k % 2 else -GAUSS) - p[0]) * cells[0]
        across[k] = falloff(x[k], height, exponents[1])
    for k in range(2 * rows):
        y = (k // 2 + 0.5 + (GAUSS if k % 2 else -GAUSS) - p[1]) * cells[1]
        strength = falloff(y, height, exponents[0]) * height / 4
        ahead = normal[1] * y - normal[2] * height
        squared = y * y + height * height
        for g in range(2 * columns):
            distance = x[g] * x[g] + squared
            towards = max(normal[0] * x[g] + ahead, 0.0)
            light[g] = strength * across[g] * towards / (distance * distance)
        first = (k // 2) * columns
        for c in range(columns):
            out[first + c] += light[2 * c] + light[2 * c + 1]


@compiled
def falloff(aside: float, height: float, exponent: float) -> float:
    """Return a power of the cosine of an angle of the monitor."""
    return float((height / np.sqrt(height * height + aside * aside)) ** exponent)


@compiled
def turns_about(
    p: Array,
    planes: Array,
    two_sided: NDArray[np.bool_],
    starts: Indices,
    faces: Indices,
    signs: Indices,
) -> Indices:
    """Return how many more layers lie to one side of each edge than to the other, seen from p."""
    front = np.empty(len(planes), np.int64)
    for f in range(len(planes)):
        n = planes[f]
        towards = n[0] * p[0] + n[1] * p[1] + n[2] * p[2] + n[3] > 0
        front[f] = 1 if towards else (-1 if two_sided[f] else 0)
    turns = np.zeros(len(starts) - 1, np.int64)
    for e in range(len(turns)):
        for k in range(starts[e], starts[e + 1]):
            turns[e] += signs[k] * front[faces[k]]
    return turns


@compiled
def border_of(
    p: Array, vertices: Array, edges: Indices, turns: Indices, rows: int
) -> tuple[Array, Indices, Indices]:
    """Return the shadow's border, (n, 4) of (u, v) at either end, downwards, and its turns, (n,).

    Third are the vertices at the ends, (n, 2). Edges past the first or the last row are left out.
    """
    border, layers, count = np.empty((len(edges), 4)), np.empty(len(edges), np.int64), 0
    between = np.empty((len(edges), 2), np.int64)
    ends = np.empty((2, 2))
    for e in range(len(edges)):
        if turns[e] == 0:
            continue
        for end in range(2):
            vertex = vertices[edges[e, end]]
            stretch = p[2] / (p[2] - vertex[2])
            for axis in range(2):
                ends[end, axis] = p[axis] + stretch * (vertex[axis] - p[axis])
        upper = 0 if ends[0, 1] <= ends[1, 1] else 1
        if ends[1 - upper, 1] <= 0 or ends[upper, 1] >= rows:
            continue
        border[count, :2], border[count, 2:] = ends[upper], ends[1 - upper]
        layers[count] = turns[e] if upper == 0 else -turns[e]
        between[count, 0], between[count, 1] = edges[e, upper], edges[e, 1 - upper]
        count += 1
    return border[:count], layers[:count], between[:count]


@compiled
def lines_across(border: Array, shape: Indices) -> tuple[Array, Indices]:
    """Return where lines across the shadow begin and end, ascending in v.

    Second is which end of the border each is, 2 e or 2 e + 1 of the e-th edge, or -1.
    """
    rows, columns = shape
    of_row = -(-LINES // rows)
    first = max(0, int(np.floor(border[:, 1].min() * of_row)))
    last = min(rows * of_row, int(np.ceil(border[:, 3].max() * of_row)))
    ends = np.empty(last - first + 1 + 2 * len(border))
    of_border = np.full(len(ends), -1)
    count = 0
    for k in range(first, last + 1):
        ends[count] = k / of_row
        count += 1
    for e in range(len(border)):
        u0, v0, u1, v1 = border[e]
        if v1 - v0 < ALONG * abs(u1 - u0) and max(u0, u1) > 0 and min(u0, u1) < columns:
            for end in range(2):
                v = border[e, 2 * end + 1]
                if 0 < v < rows:
                    ends[count], of_border[count] = v, 2 * e + end
                    count += 1
    order = np.argsort(ends[:count])
    return ends[:count][order], of_border[:count][order]


@compiled
def remove_shadow(
    p: Array,
    normal: Array,
    cells: Array,
    exponents: Array,
    border: Array,
    layers: Indices,
    lines: Array,
    shape: Indices,
    out: Array,
) -> None:
    """Subtract the light that lies within the border, line by line."""
    across = sides(p, cells, exponents, shape)
    crossings, crossed = np.empty(len(border)), np.empty(len(border), np.int64)
    for k in range(len(lines) - 1):
        thickness, v = lines[k + 1] - lines[k], (lines[k] + lines[k + 1]) / 2
        if thickness > 0:
            count = cross(border, v, crossings, crossed)
            row = out[int(v) * shape[1] : (int(v) + 1) * shape[1]]
            remove_line(
                p, normal, cells, exponents, across, layers, crossings, crossed[:count],
                v, thickness, row,
            )  # fmt: skip


@compiled
def sides(p: Array, cells: Array, exponents: Array, shape: Indices) -> Array:
    """Return how light falls off across the monitor at the patches' sides, (C + 1,).

    Between them it is all but linear.
    """
    across = np.empty(shape[1] + 1)
    for c in range(len(across)):
        across[c] = falloff((c - p[0]) * cells[0], p[2], exponents[1])
    return across


@compiled
def remove_line(
    p: Array,
    normal: Array,
    cells: Array,
    exponents: Array,
    across: Array,
    layers: Indices,
    crossings: Array,
    crossed: Indices,
    v: float,
    thickness: float,
    row: Array,
) -> None:
    """Subtract the light at v, (C,), that lies where a line has crossed into the border."""
    y, height = (v - p[1]) * cells[1], p[2]
    strength = falloff(y, height, exponents[0]) * height * thickness
    ahead = normal[1] * y - normal[2] * height
    squared = y * y + height * height
    before = 0
    for e in range(len(crossed) - 1):
        before += layers[crossed[e]]
        if before == 0:
            continue
        left, right = max(crossings[e], 0.0), min(crossings[e + 1], float(len(row)))
        c = int(left)
        while left < right:
            end = min(right, c + 1.0)
            for side in (-GAUSS, GAUSS):
                u = (left + end) / 2 + side * (end - left)
                x = (u - p[0]) * cells[0]
                towards = max(normal[0] * x + ahead, 0.0)
                distance = x * x + squared
                beside = across[c] + (u - c) * (across[c + 1] - across[c])
                light = strength * beside * towards / (distance * distance)
                row[c] -= light * (end - left) / 2
            left = end
            c += 1


@compiled
def cross(border: Array, v: float, crossings: Array, crossed: Indices) -> int:
    """Write where a line meets the border, from the left, and which edges; return how often."""
    count = 0
    for e in range(len(border)):
        u0, v0, u1, v1 = border[e]
        if not v0 <= v < v1:
            continue
        u = u0 + (v - v0) / (v1 - v0) * (u1 - u0)
        at = count
        while at > 0 and crossings[at - 1] > u:
            crossings[at], crossed[at] = crossings[at - 1], crossed[at - 1]
            at -= 1
        crossings[at], crossed[at] = u, e
        count += 1
    return count
