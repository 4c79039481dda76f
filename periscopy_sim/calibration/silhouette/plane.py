"""The rectangle in which an unknown flat occluder lies, and the cells that it is cut into."""

from dataclasses import dataclass
from typing import Self

import numpy as np
from numpy.typing import NDArray

from periscopy_sim.errors import SceneError, did_you_mean
from periscopy_sim.geometry import Geometry
from periscopy_sim.numerics import Array

Cells = NDArray[np.bool_]

SLENDER = 0.1
"""Thickness of a shape over its width up to which it is flat; and the cosine of the angle between
its normal and the way from monitor to wall, up to which it is edge on."""


@dataclass(frozen=True, eq=False)
class MaskPlane:
    """A rectangle cut into rows x columns of cells, row by row from its top left.

    That is the top left as one sees it who faces the wall. Lengths are in metres.
    """

    corner: Array  # (3,) the top left one
    across: Array  # (3,) along the top edge, as long as it
    down: Array  # (3,) along the left edge, as long as it

    @classmethod
    def of(cls, scenario: Geometry, name: str) -> Self:
        """Return the rectangle about the flat occluder of a name, in its middle plane.

        A SceneError says that there can be no mask.
        """
        wall, hidden = scenario.view.frame, scenario.hidden
        vertices = {o.name: o.vertices for o in scenario.view.occluders if o.vertices is not None}
        if name not in vertices:
            hint = did_you_mean(name, vertices) or f"there are {', '.join(vertices) or 'none'}"
            raise SceneError(
                f"scene '{scenario.path}': '{name}' is no occluder of flat faces; {hint}"
            )
        points, way = vertices[name], hidden.centers.mean(axis=0) - wall.center
        ahead = way / np.linalg.norm(way)
        _, sizes, axes = np.linalg.svd(points - points.mean(axis=0), full_matrices=False)
        normal = axes[2] * np.sign(axes[2] @ ahead)
        down = -wall.up + (wall.up @ normal) * normal
        down /= np.linalg.norm(down)
        axes = np.stack([np.cross(normal, down), down, normal])
        inside = points @ axes.T
        low, size = inside.min(axis=0), np.ptp(inside, axis=0)
        corner = (low + size * np.array([0, 0, 0.5])) @ axes
        plane = cls(corner, size[0] * axes[0], size[1] * axes[1])
        ends = plane.points(np.stack(np.meshgrid([0, 1], [0, 1]), axis=-1).reshape(-1, 2))
        from_wall = (ends - wall.center) @ wall.normal
        from_hidden = [
            (ends - each.centers.mean(axis=0)) @ each.normals.mean(axis=0)
            for each in hidden.values()
        ]
        flat = sizes[2] <= SLENDER * sizes[1] and normal @ ahead > SLENDER
        if not (flat and min(*size[:2], *from_wall, np.min(from_hidden)) > 0):
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

    def fraction(self, scenario: Geometry) -> float:
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

    def pixels_a_cell(self, scenario: Geometry, cells: tuple[int, int]) -> float:
        """Return how many pixels, seen from a point of the monitor, the smaller cell side has.

        A SceneError says that there are fewer than two cells, or less than a pixel in each.
        """
        grid = scenario.view.centers.reshape(*scenario.photograph_shape, 3)
        steps = [np.linalg.norm(np.diff(grid, axis=k), axis=2) for k in (0, 1) if grid.shape[k] > 1]
        pixel = (1 - self.fraction(scenario)) * max(float(step.mean()) for step in steps)
        most = np.array(self.sides) / pixel
        if not (min(cells) >= 1 and max(cells) > 1 and np.all(most >= cells)):
            rows, columns = np.maximum(most, 1).astype(int)
            raise SceneError(
                f"{cells[0]}x{cells[1]} cells: a mask has two cells at least, and at most "
                f"{rows}x{columns}, one a pixel, whose shadows the photograph resolves"
            )
        return float(np.min(most / cells))
