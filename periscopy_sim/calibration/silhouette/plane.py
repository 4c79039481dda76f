"""The rectangle in which an unknown flat occluder lies, and the cells that it is cut into."""

from dataclasses import dataclass
from typing import Self

import numpy as np
from numpy.typing import NDArray

from periscopy_sim.errors import SceneError, did_you_mean
from periscopy_sim.numerics import Array
from periscopy_sim.scenario import Scenario

Cells = NDArray[np.bool_]

SLENDER = 0.1
"""Thickness of a shape over its width up to which it is flat; and the cosine of the angle between
its normal and the way from monitor to wall, up to which it is edge on."""

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
        """Return the rectangle about the flat occluder of a name, in its middle plane.

        A SceneError says that there can be no mask.
        """
        wall, hidden = scenario.view.frame, scenario.hidden
        points, monitor = _points(scenario, name), hidden.centers.mean(axis=0)
        ahead = (monitor - wall.center) / np.linalg.norm(monitor - wall.center)
        _, sizes, axes = np.linalg.svd(points - points.mean(axis=0), full_matrices=False)
        normal = axes[2] * np.sign(axes[2] @ ahead)
        down = -wall.up + (wall.up @ normal) * normal
        down /= np.linalg.norm(down)
        axes = np.stack([np.cross(normal, down), down, normal])
        inside = points @ axes.T
        low, size = inside.min(axis=0), np.ptp(inside, axis=0)
        corner = (low + size * np.array([0, 0, 0.5])) @ axes
        plane = cls(corner, size[0] * axes[0], size[1] * axes[1])
        ends = plane.points(CORNERS)
        from_wall = (ends - wall.center) @ wall.normal
        from_monitor = (ends - monitor) @ hidden.normals.mean(axis=0)
        flat = sizes[2] <= SLENDER * sizes[1] and normal @ ahead > SLENDER
        if not (flat and min(*size[:2], *from_wall, *from_monitor) > 0):
            raise SceneError(
                f"scene '{scenario.path}': occluder '{name}' is not flat, has no area, is edge on "
                "to the monitor, or not between monitor and wall; put a rectangle in its place "
                "that faces both"
            )
        return plane

    @property
    def sides(self) -> tuple[float, float]:
        """Its height and its width."""
        return float(np.linalg.norm(self.down)), float(np.linalg.norm(self.across))

    def square_cells(self, longest: int = 16) -> tuple[int, int]:
        """Return (rows, columns) of cells as square as can be, so many along the longer side."""
        rows, columns = (max(1, round(longest * side / max(self.sides))) for side in self.sides)
        return rows, columns

    def points(self, places: Array) -> Array:
        """Return the points, (..., 3), at places across and down, (..., 2), from 0 to 1."""
        return np.asarray(self.corner + places[..., :1] * self.across + places[..., 1:] * self.down)

    def fraction(self, scenario: Scenario) -> float:
        """Return the fraction of the way from the wall to the monitor at which it stands."""
        normal = np.cross(self.across, self.down)
        wall, monitor = (
            float((points.mean(axis=0) - self.corner) @ normal)
            for points in (scenario.view.centers, scenario.hidden.centers)
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

    def pixels_a_cell(self, scenario: Scenario, cells: tuple[int, int]) -> float:
        """Return how many pixels, seen from a point of the monitor, the smaller cell side has.

        A SceneError says that there are fewer than two cells, or less than a pixel in each.
        """
        grid = scenario.view.centers.reshape(*scenario.photograph_shape, 3)
        steps = [np.linalg.norm(np.diff(grid, axis=k), axis=2) for k in (0, 1) if grid.shape[k] > 1]
        pixel = (1 - self.fraction(scenario)) * max(float(step.mean()) for step in steps)
        if min(cells) < 1 or max(cells) < 2:
            raise SceneError("a mask needs two cells at least")
        across = min(side / count for side, count in zip(self.sides, cells, strict=True)) / pixel
        if across < 1:
            rows, columns = (max(1, int(side / pixel)) for side in self.sides)
            raise SceneError(
                f"{cells[0]}x{cells[1]} cells are more than the photograph resolves, whose pixels "
                f"are {1e3 * pixel:.2g} mm wide at the mask; ask for {rows}x{columns} at most"
            )
        return across


def _points(scenario: Scenario, name: str) -> Array:
    """Return points, (n, 3), about which the rectangle is drawn."""
    occluders = {occluder.name: occluder for occluder in scenario.scene.occluders}
    if name not in occluders:
        listed = "the occluders are " + (", ".join(f"'{each}'" for each in occluders) or "none")
        hint = did_you_mean(name, occluders) or listed
        raise SceneError(f"scene '{scenario.path}': '{name}' is no occluder; {hint}")
    vertices = occluders[name].vertices
    if vertices is not None:
        return vertices
    plugin, to_world = scenario.scene.plugins[name], scenario.scene.places[name]
    if plugin not in ("rectangle", "disk"):
        raise SceneError(f"scene '{scenario.path}': '{name}' is a {plugin}; make it a rectangle")
    return np.asarray((2 * CORNERS - 1) @ to_world[:3, :2].T + to_world[:3, 3])
