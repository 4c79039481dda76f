"""What a wall point sees of the monitor, patch by patch: areas, no rays.

Patches are cut into cells, so small that light is all but linear over each. The outline then gives
the shadow's area and centroid within a cell, as in a rasterizer: each segment adds what lies to its
right, in its own cell and in all that follow.

Coordinates are the outline's; a cell's own begin at its middle. Light is in units of ρ/π times
a patch's area.

A wall point p projects the occluders onto the monitor's plane, where the edges of `borders` bound
their shadow. A line across the monitor meets them from the left, and counts how many layers lie
before p (the nonzero winding rule: Foley, van Dam, Feiner, Hughes, Computer Graphics, 1990, Sec.
19.5.2); where there is one, the monitor is hidden. The line sweeps down, and the order of the edges
changes only where one begins, ends or crosses another (Bentley, Ottmann, IEEE Trans. Comput. 28,
1979). What parts shadow from light there is the outline; it is closed whatever is rounded, since
all edges between two stops are taken in one order.

A face of a closed solid hides what is behind it where its front is towards the point. A part that
is no closed solid hides by either side. Over the border of what faces hide, each counted once,
turns right and left along an edge cancel, except at the border (Appel, ACM National Conf., 1967).

Coordinates are the monitor's: u in columns of cells from the left, v in rows from the top, and h,
the height above its plane, in metres.

The light that a shadow takes away changes where its border moves, by what shines there, and with
what shines within (Reynolds' transport theorem). The first is an integral along the shadow's
outline, of all parameters at once; the second, smooth, is the light's gradient with the border as
it is. Derivatives good to a percent would not do: of what each of a dozen parameters does a
hundredth may be all by which they differ.
"""

from collections.abc import Sequence
from typing import NamedTuple, TypeAlias

import numpy as np
from numpy.typing import NDArray
from scipy.sparse import coo_array
from scipy.sparse.csgraph import connected_components

from periscopy_sim.hidden import GAUSS
from periscopy_sim.numerics import Array
from periscopy_sim.numerics.products import compiled, compiled_reordered

Indices = NDArray[np.int64]

SAME = float(np.finfo(np.float32).eps)
"""Fraction of the largest coordinate within which vertices are one, as in float32 meshes."""


class Borders(NamedTuple):  # which compiled functions take
    """The edges of some meshes, and the faces beside each."""

    vertices: Array  # (V, 3)
    sources: Indices  # (V,) which of all meshes' vertices each is
    planes: Array  # (F, 4) a point sees the front of a face where plane · (point, 1) > 0
    two_sided: NDArray[np.bool_]  # (F,) whether a face hides from both sides
    edges: Indices  # (E, 2) vertices
    starts: Indices  # (E + 1,) where in `faces` those beside each edge begin
    faces: Indices  # (K,)
    signs: Indices  # (K,) 1 where the face turns about the edge in its order of vertices, or -1


def borders_of(meshes: Sequence[tuple[Array, Indices]]) -> Borders:
    """Return the borders of meshes, each of (V, 3) vertices and (F, 3) faces.

    Vertices in the same place are one, whatever their indices; a face without area is left out.
    """
    none = np.empty((0, 3))
    given = np.concatenate([none, *(vertices for vertices, _ in meshes)])
    starts = np.cumsum([0, *(len(vertices) for vertices, _ in meshes)])
    faces = [faces + start for (_, faces), start in zip(meshes, starts[:-1], strict=True)]
    cells = [SAME * max(float(np.abs(v).max(initial=0)), 1e-30) for v, _ in meshes]
    mesh = np.repeat(np.arange(len(meshes)), np.diff(starts))
    place = np.column_stack([mesh, np.rint(given / np.array(cells)[mesh, None])])
    _, sources, welded = np.unique(place, axis=0, return_index=True, return_inverse=True)
    vertices = given[sources]
    triangles = welded.ravel()[np.concatenate([none.astype(np.int64), *faces])]
    a, b, c = triangles.T
    triangles = triangles[(a != b) & (b != c) & (c != a)]
    a, b, c = vertices[triangles].swapaxes(0, 1)
    normals = np.cross(b - a, c - a)
    planes = np.column_stack([normals, -np.einsum("fi,fi->f", normals, a)])
    directed = np.concatenate([triangles[:, [0, 1]], triangles[:, [1, 2]], triangles[:, [2, 0]]])
    face = np.tile(np.arange(len(triangles)), 3)
    sign = np.where(directed[:, 0] < directed[:, 1], 1, -1)
    edges, edge = np.unique(np.sort(directed, axis=1), axis=0, return_inverse=True)
    edge = edge.ravel()
    count = len(triangles) + len(edges)
    joined = coo_array((np.ones(len(face)), (face, len(triangles) + edge)), shape=(count, count))
    part = connected_components(joined, directed=False)[1]
    unbalanced = np.bincount(edge, sign, len(edges)) != 0  # turns about an edge of a solid cancel
    two_sided = np.isin(part[: len(triangles)], part[len(triangles) :][unbalanced])
    order = np.argsort(edge, kind="stable")
    first = np.searchsorted(edge[order], np.arange(len(edges) + 1))
    return Borders(vertices, sources, planes, two_sided, edges, first, face[order], sign[order])


Piece: TypeAlias = tuple[int, float, float, int]
"""An edge, v at a piece's upper and lower end, and 1 where shadow lies to its right, or -1."""

Segment: TypeAlias = tuple[int, int, int, int, float, float, float, float]
"""An edge, 1 or -1 as in `Piece`, row and column of a cell, and (u, v) where it enters, leaves."""

SHEAR = float(np.sqrt(np.finfo(np.float64).eps))
"""Rows per column by which v is askew: edges that are built along the rows then begin and end."""


@compiled
def turns_about(p: Array, borders: Borders) -> Indices:
    """Return how many more layers lie to one side of each edge than to the other, seen from p."""
    front = np.empty(len(borders.planes), np.int64)
    for f in range(len(front)):
        n = borders.planes[f]
        towards = n[0] * p[0] + n[1] * p[1] + n[2] * p[2] + n[3] > 0
        front[f] = 1 if towards else (-1 if borders.two_sided[f] else 0)
    turns = np.zeros(len(borders.edges), np.int64)
    for e in range(len(turns)):
        for k in range(borders.starts[e], borders.starts[e + 1]):
            turns[e] += borders.signs[k] * front[borders.faces[k]]
    return turns


@compiled
def border_of(p: Array, borders: Borders, shape: Indices) -> tuple[Array, Indices, Indices]:
    """Return the edges that bound any shadow, (n, 4) of (u, v) at either end, downwards.

    Second are their turns, (n,), third the vertices at their ends, (n, 2). Edges above, below and
    to the right of all cells are left out.
    """
    edges, vertices = borders.edges, borders.vertices
    rows, columns = shape
    turns = turns_about(p, borders)
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
            ends[end, 1] += SHEAR * ends[end, 0]
        upper = 0 if ends[0, 1] <= ends[1, 1] else 1
        lower = 1 - upper
        if ends[lower, 1] <= 0 or ends[upper, 1] >= rows or ends[upper, 1] == ends[lower, 1]:
            continue
        if min(ends[0, 0], ends[1, 0]) >= columns:
            continue
        for axis in range(2):
            border[count, axis], border[count, 2 + axis] = ends[upper, axis], ends[lower, axis]
        layers[count] = turns[e] if upper == 0 else -turns[e]
        between[count, 0], between[count, 1] = edges[e, upper], edges[e, lower]
        count += 1
    return border[:count], layers[:count], between[:count]


@compiled
def outline_of(border: Array, layers: Indices, rows: int) -> list[Piece]:
    """Return what of a border parts shadow from light."""
    n, begun, count = len(border), 0, 0
    heights = np.empty(2 * n)
    for e in range(n):
        heights[e], heights[n + e] = border[e, 1], border[e, 3]
    downwards, stops = np.argsort(heights[:n]), np.empty(2 * n)
    for k, e in enumerate(np.argsort(heights)):
        stops[k] = min(max(heights[e], 0.0), rows)
    active, upper, lower = np.empty(n, np.int64), np.empty(n), np.empty(n)
    side, since = np.zeros(n, np.int64), np.empty(n)  # where shadow is now, as in `Piece`
    pieces = [(0, 0.0, 0.0, 0) for _ in range(0)]
    for k in range(len(stops)):
        top = stops[k]
        if k + 1 < len(stops) and stops[k + 1] == top:
            continue
        last, count = count, 0
        for a in range(last):
            e = active[a]
            if border[e, 3] > top and top < rows:
                active[count] = e
                count += 1
            elif side[e] != 0:
                pieces.append((e, since[e], top, side[e]))
        while begun < n and border[downwards[begun], 1] <= top:
            if border[downwards[begun], 3] > top:
                active[count] = downwards[begun]
                count += 1
            begun += 1
        if count == 0 or k + 1 == len(stops):
            continue
        thickness = stops[k + 1] - top
        for e in active[:count]:
            u0, v0, u1, v1 = border[e]
            slope = (u1 - u0) / (v1 - v0)
            upper[e], lower[e] = u0 + (top - v0) * slope, u0 + (stops[k + 1] - v0) * slope
        above = 0.0
        for below in _crossings(active[:count], upper, lower):
            _sort(active[:count], upper, lower, (above + below) / 2)
            _count_layers(active[:count], layers, top + above * thickness, side, since, pieces)
            above = below
    return pieces


@compiled
def _count_layers(
    active: Indices, layers: Indices, v: float, side: Indices, since: Array, pieces: list[Piece]
) -> None:
    """Note what each edge parts from v on; where that changes, what it parted is a piece."""
    before = 0
    for e in active:
        after = before + layers[e]
        parts = (1 if after != 0 else 0) - (1 if before != 0 else 0)
        before = after
        if parts != side[e]:
            if side[e] != 0:
                pieces.append((e, since[e], v, side[e]))
            side[e], since[e] = parts, v


@compiled
def _crossings(active: Indices, upper: Array, lower: Array) -> list[float]:
    """Return where edges cross between two stops, as parts of the way down; at last 1.

    `upper` and `lower` are u of each edge at the two. The active edges are brought into order.
    """
    _sort(active, upper, lower, 0.0)
    order, parts = active.copy(), [1.0]
    for a in range(1, len(order)):
        e, at = order[a], a
        while at > 0 and lower[order[at - 1]] > lower[e]:
            other = order[at - 1]
            apart = upper[e] - upper[other]
            if apart > 0:
                part, place = apart / (apart + lower[other] - lower[e]), len(parts)
                while place > 0 and parts[place - 1] > part:
                    place -= 1
                parts.insert(place, part)
            order[at] = other
            at -= 1
        order[at] = e
    return parts


@compiled
def _sort(active: Indices, upper: Array, lower: Array, part: float) -> None:
    """Sort edges, all but sorted, from the left, at a part of the way between two stops."""
    for a in range(1, len(active)):
        e, at = active[a], a
        u = upper[e] + part * (lower[e] - upper[e])
        while at > 0:
            other = active[at - 1]
            if upper[other] + part * (lower[other] - upper[other]) <= u:
                break
            active[at] = other
            at -= 1
        active[at] = e


@compiled
def cut_by_cells(border: Array, pieces: list[Piece], shape: Indices) -> list[Segment]:
    """Return an outline cut at the cells' sides; what lies left of all cells has column -1."""
    columns = shape[1]
    segments = [(0, 0, 0, 0, 0.0, 0.0, 0.0, 0.0) for _ in range(0)]
    for e, first, last, sign in pieces:
        u0, v0, u1, v1 = border[e]
        slope = (u1 - u0) / (v1 - v0)
        u, v = u0 + (first - v0) * slope, first
        while v < last:
            row = int(v)
            down = min(row + 1.0, last)
            while v < down:
                if slope > 0:
                    side = max(np.floor(u) + 1, 0.0)
                else:
                    side = min(np.ceil(u) - 1, float(columns))
                below = np.inf
                if 0 <= side <= columns and slope != 0:
                    below = max(v + (side - u) / slope, v)
                if below >= down:
                    side, below = u0 + (down - v0) * slope, down
                middle = (u + side) / 2
                if middle < 0:
                    segments.append((e, sign, row, -1, 0.0, v, 0.0, below))
                elif middle < columns:
                    segments.append((e, sign, row, int(middle), u, v, side, below))
                u, v = side, below
    return segments


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
    for q in range(P):
        for axis in range(2):
            motions[6 + axis, q] = moved.cells[q, axis]
            motions[8 + axis, q] = moved.exponents[q, axis]
    for i in range(len(lit.points)):
        changes[:] = 0
        for k in range(K):
            p, normal = lit.points[i, k], lit.normals[i, k]
            border, layers, between = border_of(p, borders, shape)
            segments = cut_by_cells(border, outline_of(border, layers, rows), shape)
            motion = _motion(p, borders.vertices, moved.points[:, i, k], moved_vertices, between)
            _move_border(p, normal, lit.cells, lit.exponents, border, segments, motion, changes)
            moves = False
            for q in range(P):
                for axis in range(3):
                    motions[axis, q] = moved.points[q, i, k, axis]
                    motions[3 + axis, q] = moved.normals[q, i, k, axis]
                for n in range(NUMBERS):
                    moves = moves or motions[n, q] != 0
            if moves:
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
            for n in range(NUMBERS):
                slopes[n] = gradient[n, r, c]
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
