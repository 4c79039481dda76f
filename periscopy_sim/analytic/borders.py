"""Borders of shadows: the edges of occluders that part a face towards a point from what is not.

A face of a closed solid hides what is behind it where its front is towards the point. A part that
is no closed solid hides by either side. Over the border of what faces hide, each counted once,
turns right and left along an edge cancel, except at the border (Appel, ACM National Conf., 1967).
"""

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from periscopy_sim.scenario import Array

Indices = NDArray[np.int64]

SAME = float(np.finfo(np.float32).eps)
"""Of the largest coordinate: vertices so near are one, as meshes in single precision have them."""


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
    from scipy.sparse import coo_array
    from scipy.sparse.csgraph import connected_components

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
