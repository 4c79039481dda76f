"""Shadows of convex parts on a plane, by central projection.

A convex part's shadow from a point source is the convex hull of its projected vertices.
Coordinates are those of the plane: (across, up, height), in metres, the plane at height 0.
"""

import numpy as np
from numpy.typing import NDArray
from scipy.sparse import coo_array
from scipy.sparse.csgraph import connected_components
from scipy.spatial import ConvexHull

from periscopy_sim.numerics.compilation import compiled
from periscopy_sim.scenario import Array

Indices = NDArray[np.int64]

# Metres that a shadow reaches beyond its border: parts that share an edge leave no bright seam.
_SEAM = 1e-12


def connected_parts(vertices: Array, faces: Indices) -> list[tuple[Array, Indices]]:
    """Split a mesh, (V, 3) positions and (F, 3) vertex indices, where its triangles share no index.

    Vertices that no triangle uses are left out.
    """
    start, end = faces[:, [0, 1]].T.ravel(), faces[:, [1, 2]].T.ravel()
    edges = coo_array((np.ones(len(start)), (start, end)), shape=(len(vertices), len(vertices)))
    label = connected_components(edges, directed=False)[1][faces[:, 0]]
    order = np.argsort(label, kind="stable")
    parts = []
    for group in np.split(faces[order], np.flatnonzero(np.diff(label[order])) + 1):
        used, local = np.unique(group, return_inverse=True)
        parts.append((vertices[used], local.reshape(group.shape)))
    return parts


def is_convex(vertices: Array, faces: Indices) -> bool:
    """Return whether a mesh bounds a convex solid or fills a flat convex polygon.

    That is so where the content of the faces (the enclosed volume, or the area of a flat mesh) is
    the content of the vertices' convex hull, to one part in a million and to what rounding the
    vertices to single precision can dent; and where the mesh shrinks to a line or a point. The
    (V, 3) vertices are all used, and the (F, 3) faces consistently oriented.
    """
    rounding = np.finfo(np.float32).eps * np.abs(vertices).max()
    corners = vertices - vertices.mean(axis=0)
    corners = corners @ np.linalg.svd(corners, full_matrices=False)[2].T
    corners = corners[:, np.ptp(corners, axis=0) > rounding]
    dimensions = corners.shape[1]
    if dimensions < 2:
        return True
    a, b, c = corners[faces].swapaxes(0, 1)
    if dimensions == 3:
        content = abs(np.sum(a * np.cross(b, c))) / 6
    else:
        content = abs(np.linalg.det(np.stack([b - a, c - a], axis=1)).sum()) / 2
    hull = ConvexHull(corners)
    return bool(abs(hull.volume - content) <= 1e-6 * hull.volume + rounding * hull.area)


@compiled
def lit_points(
    points: Array, foot: Array, height: float, vertices: Array, starts: Indices
) -> NDArray[np.bool]:
    """Return which of the (M, 2) points of the plane lie in no part's shadow, (M,).

    Points are across and up, sorted by the first. The point source stands at `height` above `foot`,
    higher than every vertex. `vertices` are (V, 3) of the convex parts, one part after the other,
    none below the plane; `starts` (P + 1,) is where each part begins in them, and V.
    """
    lit = np.ones(len(points), np.bool_)
    for part in range(len(starts) - 1):
        corners = vertices[starts[part] : starts[part + 1]]
        shadow = np.empty((len(corners), 2))
        for v in range(len(corners)):
            stretch = height / (height - corners[v, 2])  # along the ray from the source
            for axis in range(2):
                shadow[v, axis] = foot[axis] + stretch * (corners[v, axis] - foot[axis])
        hull = _convex_hull(shadow)
        if len(hull) > 2:
            _darken(points, hull, lit)
    return lit


@compiled
def _convex_hull(points: Array) -> Array:
    """Corners of the convex hull of (n, 2) points, counterclockwise (Andrew's monotone chain)."""
    count = len(points)
    order = np.argsort(points[:, 1].copy(), kind="mergesort")
    order = order[np.argsort(points[:, 0].copy()[order], kind="mergesort")]
    hull = np.empty((2 * count, 2))
    size = first = 0
    # To the right along the lower border, then back along the upper one.
    for k in range(2 * count - 1):
        if k == count:
            first = size - 1
        i = order[k if k < count else 2 * count - 2 - k]
        # Drop corners where the border would not turn left.
        while size - first >= 2:
            a, b, c = hull[size - 2], hull[size - 1], points[i]
            if (b[0] - a[0]) * (c[1] - b[1]) > (b[1] - a[1]) * (c[0] - b[0]):
                break
            size -= 1
        hull[size, 0], hull[size, 1] = points[i, 0], points[i, 1]
        size += 1
    return hull[: size - 1]


@compiled
def _darken(points: Array, shadow: Array, lit: NDArray[np.bool]) -> None:
    """Clear `lit` for the points within every half-plane left of the shadow's border."""
    corners = len(shadow)
    normal = np.empty((corners, 2))
    offset = np.empty(corners)
    left = right = shadow[0, 0]
    for e in range(corners):
        left, right = min(left, shadow[e, 0]), max(right, shadow[e, 0])
        a, b = shadow[e], shadow[(e + 1) % corners]
        length = np.hypot(b[0] - a[0], b[1] - a[1])
        normal[e, 0] = (b[1] - a[1]) / length
        normal[e, 1] = (a[0] - b[0]) / length
        offset[e] = normal[e, 0] * a[0] + normal[e, 1] * a[1] + _SEAM
    first = np.searchsorted(points[:, 0], left - _SEAM)
    last = np.searchsorted(points[:, 0], right + _SEAM)
    for i in range(first, last):
        inside = True
        for e in range(corners):
            if normal[e, 0] * points[i, 0] + normal[e, 1] * points[i, 1] > offset[e]:
                inside = False
                break
        if inside:
            lit[i] = False
