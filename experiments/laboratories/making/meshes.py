"""The laboratory's occluder, as a closed mesh (metres, z up)."""

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
