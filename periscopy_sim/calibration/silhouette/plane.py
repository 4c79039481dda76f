"""The rectangle in which an unknown flat occluder lies, and the cells that it is cut into."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Self

import numpy as np
from numpy.typing import NDArray

from periscopy_sim.errors import SceneError, did_you_mean
from periscopy_sim.rendering.scene.nodes import SceneNodes
from periscopy_sim.scenario import Array, Occluder, Scenario, corners, wall_frame

Cells = NDArray[np.bool_]

FLAT = 0.1
"""Thickness of a shape over its width up to which it is flat, and its own plane is the mask's."""

LONGEST = 16
"""Cells along the longer side of the rectangle by default."""

EDGE_ON = 0.2
"""Cosine of the angle between a mask's normal and the way from monitor to wall, below which it is
seen edge on."""

CORNERS = np.array([[0.0, 0.0], [1.0, 0.0], [1.0, 1.0], [0.0, 1.0]])


@dataclass(frozen=True, eq=False)
class MaskPlane:
    """A rectangle cut into rows x columns of cells, row by row from its top left.

    That is the top left as one sees it who faces the wall. Lengths are in metres.
    """

    corner: Array  # (3,) the top left one
    across: Array  # (3,) along the top edge, as long as it
    down: Array  # (3,) along the left edge, as long as it

    @classmethod
    def of(cls, scenario: Scenario, name: str) -> Self:
        """Return the rectangle about the occluder of a name: in its own plane if it is flat.

        Else in the plane parallel to the wall through its middle, about what it covers there of the
        way from the middle of the monitor to that of the wall. A SceneError says why there can be
        no mask.
        """
        wall = wall_frame(scenario.wall_points, scenario.wall_normals, scenario.photograph_shape)
        points = _points(scenario, name)
        _, sizes, axes = np.linalg.svd(points - points.mean(axis=0), full_matrices=False)
        normal = axes[2] if sizes[2] <= FLAT * sizes[1] else wall.normal
        ahead = scenario.patch_centers.mean(axis=0) - wall.center
        if abs(normal @ ahead) < EDGE_ON * np.linalg.norm(ahead):
            raise _error(scenario, name, "is flat and stands edge on to the monitor; turn it")
        normal = normal * np.sign(normal @ ahead)
        down = -wall.up + (wall.up @ normal) * normal
        down /= np.linalg.norm(down)
        axes = np.stack([np.cross(normal, down), down, normal])
        inside = (points - points[0]) @ axes.T
        middle = (inside[:, 2].min() + inside[:, 2].max()) / 2
        along = axes @ ahead
        inside = (inside - (inside[:, 2:] - middle) * (along / along[2]))[:, :2]
        low, size = inside.min(axis=0), np.ptp(inside, axis=0)
        if not size.all():
            raise _error(scenario, name, "has no area; make it a rectangle")
        corner = points[0] + np.append(low, middle) @ axes
        plane = cls(corner, size[0] * axes[0], size[1] * axes[1])
        ends = plane.points(CORNERS)
        if ((ends - wall.center) @ wall.normal).min() <= 0:
            raise _error(scenario, name, "has a bounding rectangle that reaches through the wall")
        behind = scenario.patch_normals.mean(axis=0)
        if ((ends - scenario.patch_centers.mean(axis=0)) @ behind).min() <= 0:
            raise _error(scenario, name, "has a bounding rectangle that reaches behind the monitor")
        return plane

    @property
    def sides(self) -> tuple[float, float]:
        """Its height and its width."""
        return float(np.linalg.norm(self.down)), float(np.linalg.norm(self.across))

    @property
    def default_cells(self) -> tuple[int, int]:
        """(rows, columns) of cells as square as they can be, `LONGEST` along the longer side."""
        height, width = self.sides
        side = max(height, width) / LONGEST
        return max(1, round(height / side)), max(1, round(width / side))

    def points(self, places: Array) -> Array:
        """Return the points, (..., 3), at places across and down, (..., 2), from 0 to 1."""
        return np.asarray(self.corner + places[..., :1] * self.across + places[..., 1:] * self.down)

    def fraction(self, scenario: Scenario) -> float:
        """Return the fraction of the way from the wall to the monitor at which it stands."""
        normal = np.cross(self.across, self.down)
        wall, monitor = (
            float((points.mean(axis=0) - self.corner) @ normal)
            for points in (scenario.wall_points, scenario.patch_centers)
        )
        return wall / (wall - monitor)

    def rows_of_projection(self) -> tuple[Array, Array]:
        """Return rows, (3, 3), and offsets, (3,), of coordinates in the rectangle.

        rows @ p + offsets is where p is across and down, from 0 to 1, and off the plane.
        """
        rows = np.linalg.inv(
            np.stack([self.across, self.down, np.cross(self.across, self.down)], axis=1)
        )
        return rows, -rows @ self.corner

    def pixel(self, scenario: Scenario) -> float:
        """Return how large a pixel is on the mask, in metres, seen from a point of the monitor."""
        grid = scenario.wall_points.reshape(*scenario.photograph_shape, 3)
        steps = [np.linalg.norm(np.diff(grid, axis=k), axis=2) for k in (0, 1) if grid.shape[k] > 1]
        return (1 - self.fraction(scenario)) * max(float(step.mean()) for step in steps)


def require_coarse(scenario: Scenario, plane: MaskPlane, cells: tuple[int, int]) -> None:
    """Raise a SceneError if cells are smaller than a pixel; it names how many would not be."""
    pixel = plane.pixel(scenario)
    rows, columns = (max(1, int(side / pixel)) for side in plane.sides)
    if min(cells) < 1 or max(cells) < 2:
        raise SceneError("a mask needs two cells at least")
    if cells[0] > rows or cells[1] > columns:
        raise SceneError(
            f"{cells[0]}x{cells[1]} cells are more than the photograph can tell, whose pixels are "
            f"{1e3 * pixel:.2g} mm wide at the mask; ask for {rows}x{columns} at most"
        )


def _points(scenario: Scenario, name: str) -> Array:
    """Return points, (n, 3), about which the rectangle is drawn."""
    occluders = {occluder.name: occluder for occluder in scenario.occluders}
    if name not in occluders:
        listed = "the occluders are " + (", ".join(f"'{each}'" for each in occluders) or "none")
        hint = did_you_mean(name, occluders) or listed
        raise SceneError(f"scene '{scenario.path}': '{name}' is no occluder; {hint}")
    occluder: Occluder = occluders[name]
    if occluder.vertices is not None:
        return occluder.vertices
    nodes = SceneNodes(scenario.path, dict(scenario.parameters))
    plugin, to_world = nodes.plugin_and_place(name)
    if plugin in ("rectangle", "disk"):
        ends = np.append(2 * CORNERS - 1, [[0.0, 1.0]] * 4, axis=1)
        return np.asarray(ends @ to_world[:3].T)
    if occluder.bounds is None or not np.isfinite(occluder.bounds).all():
        raise _error(scenario, name, "has no bounds; make it a rectangle")
    return corners(occluder.bounds)


def _error(scenario: Scenario, name: str, reason: str) -> SceneError:
    return SceneError(f"scene '{scenario.path}': occluder '{name}' {reason}")
