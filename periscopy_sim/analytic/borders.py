"""Borders of shadows: the edges of occluders that part a face towards a point from what is not.

A face of a closed solid hides what is behind it where its front is towards the point. A part that
is no closed solid hides by either side. Over the border of what faces hide, each counted once,
turns right and left along an edge cancel, except at the border (Appel, ACM National Conf., 1967).
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from periscopy_sim.scenario import Array

Indices = NDArray[np.int64]

SAME = 1e-7
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
    first = np.cumsum([0] + [len(v) for v, _ in meshes])
    parts = [
        _borders(*_welded(np.asarray(v, np.float64), f), n)
        for (v, f), n in zip(meshes, first[:-1], strict=True)
        if len(f)
    ]
    vertices = np.cumsum([0] + [len(part.vertices) for part in parts])
    faces = np.cumsum([0] + [len(part.planes) for part in parts])
    entries = np.cumsum([0] + [len(part.faces) for part in parts])
    none = np.empty((0,), np.int64)
    numbered = list(zip(parts, vertices[:-1], faces[:-1], entries[:-1], strict=True))
    return Borders(
        vertices=np.concatenate([np.empty((0, 3)), *(part.vertices for part in parts)]),
        sources=np.concatenate([none, *(part.sources for part in parts)]),
        planes=np.concatenate([np.empty((0, 4)), *(part.planes for part in parts)]),
        two_sided=np.concatenate([np.empty(0, np.bool_), *(part.two_sided for part in parts)]),
        edges=np.concatenate([none.reshape(0, 2), *(part.edges + v for part, v, _, _ in numbered)]),
        starts=np.concatenate([[0], *(part.starts[1:] + k for part, _, _, k in numbered)]),
        faces=np.concatenate([none, *(part.faces + f for part, _, f, _ in numbered)]),
        signs=np.concatenate([none, *(part.signs for part in parts)]),
    )


def _welded(vertices: Array, faces: Indices) -> tuple[Array, Indices, Indices]:
    """Return vertices that differ, the faces of them, and which of the given each is."""
    cell = SAME * max(float(np.abs(vertices).max()), 1e-30)
    _, first, place = np.unique(
        np.rint(vertices / cell), axis=0, return_index=True, return_inverse=True
    )
    faces = place.ravel()[faces]
    a, b, c = faces.T
    return vertices[first], faces[(a != b) & (b != c) & (c != a)], first


def _borders(vertices: Array, faces: Indices, sources: Indices, before: int) -> Borders:
    from scipy.sparse import coo_array
    from scipy.sparse.csgraph import connected_components

    a, b, c = vertices[faces].swapaxes(0, 1)
    normals = np.cross(b - a, c - a)
    planes = np.column_stack([normals, -np.einsum("fi,fi->f", normals, a)])
    directed = np.concatenate([faces[:, [0, 1]], faces[:, [1, 2]], faces[:, [2, 0]]])
    face = np.tile(np.arange(len(faces)), 3)
    sign = np.where(directed[:, 0] < directed[:, 1], 1, -1)
    edges, edge = np.unique(np.sort(directed, axis=1), axis=0, return_inverse=True)
    edge = edge.ravel()
    count = len(faces) + len(edges)
    joined = coo_array((np.ones(len(face)), (face, len(faces) + edge)), shape=(count, count))
    part = connected_components(joined, directed=False)[1]
    unbalanced = np.bincount(edge, sign, len(edges)) != 0  # turns about an edge of a solid cancel
    two_sided = np.isin(part[: len(faces)], part[len(faces) :][unbalanced])
    order = np.argsort(edge, kind="stable")
    starts = np.searchsorted(edge[order], np.arange(len(edges) + 1))
    return Borders(
        vertices, before + sources, planes, two_sided, edges, starts, face[order], sign[order]
    )
