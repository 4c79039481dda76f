"""Occluders stand before the wall, never in it."""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np

from periscopy_sim.errors import SceneError
from periscopy_sim.scenario import Array, Scenario


class InFront:
    """Occluders that stood before the wall at first must stay there.

    In the scene at first, one that reaches through the part of the wall that the camera sees is a
    SceneError.
    """

    def __init__(self, scenario: Scenario) -> None:
        self._names = set()
        spacing = _spacing(scenario.wall_points)
        for name, depth, aside in _before_wall(scenario):
            through = (depth < 0) & (aside < 2 * spacing)
            if through.any() and (depth > 0).any():
                raise SceneError(_through(scenario, name, float(-depth[through].min())))
            if (depth > 0).all():
                self._names.add(name)

    def check(self, scenario: Scenario) -> None:
        """Raise a SceneError if one of them reaches through the wall."""
        for name, depth, _ in _before_wall(scenario):
            if name in self._names and (depth < 0).any():
                raise SceneError(_through(scenario, name, float(-depth.min())))


def _before_wall(scenario: Scenario) -> Iterator[tuple[str, Array, Array]]:
    """Yield each mesh's name, and how far its vertices are from the wall at its nearest point.

    Before the wall and along it, (V,) each.
    """
    from scipy.spatial import KDTree

    wall = KDTree(scenario.wall_points)
    for occluder in scenario.occluders:
        if (vertices := occluder.vertices) is None:
            continue
        _, nearest = wall.query(vertices)
        offset, normals = vertices - scenario.wall_points[nearest], scenario.wall_normals[nearest]
        depth = np.einsum("vi,vi->v", offset, normals)
        yield occluder.name, depth, np.linalg.norm(offset - depth[:, None] * normals, axis=1)


def _spacing(points: Array) -> float:
    extent = float(np.linalg.norm(np.ptp(points, axis=0)))
    return extent / float(np.sqrt(len(points)))


def _through(scenario: Scenario, name: str, depth: float) -> str:
    values = ", ".join(f"{key} = {_brief(value)}" for key, value in scenario.parameters.items())
    return (
        f"scene '{scenario.path}': occluder '{name}' reaches {1e3 * depth:.3g} mm through the wall"
        + (f" at {values}" if values else "")
        + "; start elsewhere by -D"
    )


def _brief(value: str) -> str:
    try:
        return f"{float(value):.4g}"
    except ValueError:
        return value
