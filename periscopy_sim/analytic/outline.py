"""The outline of the shadow that a wall point sees on the monitor.

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
"""

from collections.abc import Sequence
from typing import NamedTuple, TypeAlias

import numpy as np
from numpy.typing import NDArray
from scipy.sparse import coo_array
from scipy.sparse.csgraph import connected_components

from periscopy_sim.numerics import Array
from periscopy_sim.numerics.compilation import compiled

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
        border[count, :2], border[count, 2:] = ends[upper], ends[lower]
        layers[count] = turns[e] if upper == 0 else -turns[e]
        between[count, 0], between[count, 1] = edges[e, upper], edges[e, lower]
        count += 1
    return border[:count], layers[:count], between[:count]


@compiled
def outline_of(border: Array, layers: Indices, rows: int) -> list[Piece]:
    """Return what of a border parts shadow from light."""
    n, begun, count = len(border), 0, 0
    stops = np.sort(np.minimum(np.maximum(border[:, 1::2], 0.0), rows).ravel())
    downwards = np.argsort(border[:, 1])
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
                parts.append(apart / (apart + lower[other] - lower[e]))
            order[at] = other
            at -= 1
        order[at] = e
    parts.sort()
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
