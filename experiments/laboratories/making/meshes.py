"""Occluders of the stand-in laboratories, as closed meshes (metres, z up)."""

from typing import Any

import numpy as np

Mesh = Any  # trimesh.Trimesh


def lamp() -> Mesh:
    """Return a desk lamp: foot, stem, slanted arm, shade; the origin is the foot's centre."""
    import trimesh

    elbow, head = np.array([0.0, 0.0, 0.235]), np.array([0.085, 0.0, 0.335])
    parts = [
        _tube((0, 0, 0), (0, 0, 0.014), 0.055, 0.05),
        _tube((0, 0, 0.013), elbow, 0.007, 0.007),
        trimesh.creation.icosphere(subdivisions=2, radius=0.012).apply_translation(elbow),
        _tube(elbow, head, 0.006, 0.006),
        _tube((0.073, 0, 0.357), (0.13, 0, 0.26), 0.018, 0.058),
    ]
    return trimesh.util.concatenate(parts)


def shelf() -> Mesh:
    """Return a board across y with openings and two legs; the origin is its lower edge's middle."""
    thick = (-0.006, 0.006)
    bars = [
        ((-0.085, 0.085), (0.0, 0.014)),
        ((-0.085, 0.085), (0.128, 0.14)),
        ((-0.085, -0.073), (0.013, 0.129)),
        ((0.071, 0.085), (0.013, 0.129)),
        ((-0.022, -0.010), (0.013, 0.129)),
        ((-0.011, 0.072), (0.058, 0.072)),
        ((-0.074, -0.021), (0.090, 0.098)),
        ((0.028, 0.072), (0.071, 0.129)),
        ((-0.08, -0.065), (-0.38, 0.001)),
        ((0.06, 0.075), (-0.38, 0.001)),
    ]
    return _boxes([(thick, y, z) for y, z in bars])


def _boxes(extents: list[Any]) -> Mesh:
    """Return boxes over three intervals each."""
    import trimesh

    boxes = [trimesh.creation.box(bounds=np.transpose(extent)) for extent in extents]
    return trimesh.util.concatenate(boxes)


def _tube(start: Any, end: Any, first: float, last: float, sections: int = 32) -> Mesh:
    """Return a closed cone frustum from one point to another, with two radii."""
    import trimesh

    start, end = np.asarray(start, float), np.asarray(end, float)
    axis = (end - start) / np.linalg.norm(end - start)
    aside = np.cross(axis, [0, 1, 0] if abs(axis[1]) < 0.9 else [1, 0, 0])
    aside /= np.linalg.norm(aside)
    angle = 2 * np.pi * np.arange(sections) / sections
    ring = np.outer(np.cos(angle), aside) + np.outer(np.sin(angle), np.cross(axis, aside))
    vertices = np.concatenate([start + first * ring, end + last * ring, [start, end]])
    i = np.arange(sections)
    j = (i + 1) % sections
    bottom, top = np.full(sections, 2 * sections), np.full(sections, 2 * sections + 1)
    faces = np.concatenate(
        [
            np.stack([i, j, sections + j], 1),
            np.stack([i, sections + j, sections + i], 1),
            np.stack([bottom, j, i], 1),
            np.stack([top, sections + i, sections + j], 1),
        ]
    )
    return trimesh.Trimesh(vertices, faces, process=False)
