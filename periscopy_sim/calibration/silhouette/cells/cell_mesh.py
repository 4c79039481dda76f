"""The opaque cells of a mask as a flat mesh of few rectangles."""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray

from periscopy_sim.calibration.silhouette.cells.mask_plane import MaskPlane
from periscopy_sim.rendering.scene.mesh_formats import TriangleMesh

Cells = NDArray[np.bool_]


def cell_mesh(plane: MaskPlane, opaque: Cells) -> TriangleMesh:
    """Return a mesh, in the scene's coordinates, of a rectangle's opaque cells, (rows, columns).

    No two of its rectangles share a vertex: each is convex, as closed forms ask for.
    """
    rows, columns = opaque.shape
    quads = [
        plane.at(
            np.array([[left, top], [right, top], [right, bottom], [left, bottom]]) / [columns, rows]
        )
        for top, bottom, left, right in rectangles(opaque)
    ]
    faces = [np.array([[0, 2, 1], [0, 3, 2]]) + 4 * k for k in range(len(quads))]
    return TriangleMesh(np.concatenate(quads), np.concatenate(faces))


def rectangles(opaque: Cells) -> list[tuple[int, int, int, int]]:
    """Return rectangles that cover the opaque cells, each once: top, bottom, left, right.

    Each begins at the first cell that none covers yet, and grows to the right, then down.
    """
    left_over = opaque.copy()
    found = []
    while left_over.any():
        top, left = (int(n) for n in np.argwhere(left_over)[0])
        right = left + _run(left_over[top, left:])
        bottom = top + _run(left_over[top:, left:right].all(axis=1))
        left_over[top:bottom, left:right] = False
        found.append((top, bottom, left, right))
    return found


def _run(opaque: Any) -> int:
    """Return how many there are before the first that is not opaque, (n,)."""
    return len(opaque) if opaque.all() else int(np.argmin(opaque))
