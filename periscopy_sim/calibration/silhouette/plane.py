"""The rectangle in which an unknown flat occluder lies, and the cells that it is cut into."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any, Self

import numpy as np
from numpy.typing import NDArray

from periscopy_sim.errors import SceneError, did_you_mean
from periscopy_sim.rendering.scene.mesh_formats import TriangleMesh
from periscopy_sim.rendering.scene.nodes import SceneNodes
from periscopy_sim.scenario import Array, Occluder, Scenario, wall_frame

Cells = NDArray[np.bool_]

FLAT = 0.1
"""Thickness of a mesh over its width up to which it is flat, and its own plane is the mask's."""

LONGEST = 16
"""Cells along the longer side of the rectangle by default."""

SIZES = (63, 96, 126)
"""Of photographs, the longer side in pixels; the search takes one whose pixels are no larger than
cells."""

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
    def of(cls, occluder: Occluder, scenario: Scenario) -> Self:
        """Return the rectangle about an occluder: in its own plane if it is flat.

        Else in the plane parallel to the wall through its middle, about what it covers there of the
        way from the middle of the monitor to that of the wall. A SceneError says why there can be
        no mask.
        """
        wall = wall_frame(scenario.wall_points, scenario.wall_normals, scenario.photograph_shape)
        points = _points(occluder, scenario)
        _, sizes, axes = np.linalg.svd(points - points.mean(axis=0), full_matrices=False)
        normal = axes[2] if sizes[2] <= FLAT * sizes[1] else wall.normal
        ahead = scenario.patch_centers.mean(axis=0) - wall.center
        if abs(normal @ ahead) < EDGE_ON * np.linalg.norm(ahead):
            raise _refusal(scenario, occluder, "is flat and stands edge on to the monitor; turn it")
        normal = normal * np.sign(normal @ ahead)
        down = -wall.up + (wall.up @ normal) * normal
        down /= np.linalg.norm(down)
        across = np.cross(normal, down)
        inside = (points - points[0]) @ np.stack([across, down, normal]).T
        low, high = inside.min(axis=0), inside.max(axis=0)
        middle = (low[2] + high[2]) / 2
        along = np.stack([across, down, normal]) @ ahead
        inside = inside - (inside[:, 2:] - middle) * (along / along[2])
        low, high = inside.min(axis=0), inside.max(axis=0)
        if not (high - low)[:2].all():
            raise _refusal(scenario, occluder, "has no area; make it a rectangle")
        corner = points[0] + low[0] * across + low[1] * down + middle * normal
        plane = cls(corner, (high[0] - low[0]) * across, (high[1] - low[1]) * down)
        plane._check_between(scenario, occluder)
        return plane

    @property
    def sides(self) -> tuple[float, float]:
        """Its height and its width."""
        return float(np.linalg.norm(self.down)), float(np.linalg.norm(self.across))

    def at(self, places: Array) -> Array:
        """Return the points, (..., 3), at places across and down, (..., 2), from 0 to 1."""
        return np.asarray(self.corner + places[..., :1] * self.across + places[..., 1:] * self.down)

    def part(self, scenario: Scenario) -> float:
        """Return at which part of the way from the wall to the monitor it stands."""
        normal = np.cross(self.across, self.down)
        wall, monitor = (
            float((points.mean(axis=0) - self.corner) @ normal)
            for points in (scenario.wall_points, scenario.patch_centers)
        )
        return wall / (wall - monitor)

    def rows_of_projection(self) -> tuple[Array, Array]:
        """Return the rows, (3, 3), and offsets, (3,), that tell where points are of the rectangle.

        rows @ p + offsets is where p is across and down, from 0 to 1, and off the plane.
        """
        rows = np.linalg.inv(
            np.stack([self.across, self.down, np.cross(self.across, self.down)], axis=1)
        )
        return rows, -rows @ self.corner

    def _check_between(self, scenario: Scenario, occluder: Occluder) -> None:
        """Check that it lies between the monitor and the wall, with some shadow in view."""
        corners = self.at(CORNERS)
        wall = wall_frame(scenario.wall_points, scenario.wall_normals)
        if ((corners - wall.center) @ wall.normal).min() <= 0:
            raise _refusal(
                scenario, occluder, "has a bounding rectangle that reaches through the wall"
            )
        normal = scenario.patch_normals.mean(axis=0)
        if ((corners - scenario.patch_centers.mean(axis=0)) @ normal).min() <= 0:
            raise _refusal(
                scenario, occluder, "has a bounding rectangle that reaches behind the monitor"
            )
        rows, offsets = self.rows_of_projection()
        lights = (scenario.patch_centers @ rows.T + offsets)[None]
        seen = (
            scenario.wall_points[:: max(1, len(scenario.wall_points) // 512)] @ rows.T + offsets
        )[:, None]
        part = seen[..., 2:] / (seen[..., 2:] - lights[..., 2:])
        place = (seen + part * (lights - seen))[..., :2]
        if not ((place > 0) & (place < 1)).all(axis=-1).any():
            raise _refusal(
                scenario,
                occluder,
                "casts no shadow of the monitor into what the camera sees of the wall, wherever in "
                "its bounding rectangle it is opaque",
            )


def mask_plane(scenario: Scenario, name: str) -> MaskPlane:
    """Return the rectangle about the occluder of a name; a SceneError says why there is none."""
    occluders = {occluder.name: occluder for occluder in scenario.occluders}
    if name in occluders:
        return MaskPlane.of(occluders[name], scenario)
    where = f"scene '{scenario.path}'"
    listed = "the occluders are " + (", ".join(f"'{each}'" for each in occluders) or "none")
    if name in ("wall", "monitor"):
        raise SceneError(f"{where}: '{name}' is no occluder; {listed}")
    raise SceneError(f"{where} has no shape '{name}'; {did_you_mean(name, occluders) or listed}")


def _points(occluder: Occluder, scenario: Scenario) -> Array:
    """Return points, (n, 3), about which the rectangle is drawn."""
    if occluder.vertices is not None:
        return occluder.vertices
    nodes = SceneNodes(scenario.path, dict(scenario.parameters))
    plugin, to_world = nodes.plugin_and_place(occluder.name)
    if plugin in ("rectangle", "disk"):
        corners = np.append(2 * CORNERS - 1, [[0.0, 1.0]] * 4, axis=1)
        return np.asarray(corners @ to_world[:3].T)
    if occluder.bounds is None or not np.isfinite(occluder.bounds).all():
        raise _refusal(scenario, occluder, "has no bounds; make it a rectangle")
    corner = np.indices((2, 2, 2)).reshape(3, -1).T
    return np.take_along_axis(occluder.bounds, corner, axis=0)


def _refusal(scenario: Scenario, occluder: Occluder, reason: str) -> SceneError:
    return SceneError(f"scene '{scenario.path}': occluder '{occluder.name}' {reason}")


def fitted_cells(plane: MaskPlane) -> tuple[int, int]:
    """Return (rows, columns) of cells as square as they can be, `LONGEST` along the longer side."""
    height, width = plane.sides
    side = max(height, width) / LONGEST
    return max(1, round(height / side)), max(1, round(width / side))


def require_coarse(scenario: Scenario, plane: MaskPlane, cells: tuple[int, int]) -> None:
    """Check that cells are not too fine; a SceneError names how many the photograph can tell.

    A cell is at least as large as a pixel is on the mask, as seen from a point of the monitor. What
    noise and penumbrae leave of that is known once a mask is found.
    """
    pixel = _pixel_on_mask(scenario, plane)
    rows, columns = (max(1, int(side / pixel)) for side in plane.sides)
    if min(cells) < 1 or max(cells) < 2:
        raise SceneError("--cells: a mask needs two cells at least")
    if cells[0] > rows or cells[1] > columns:
        raise SceneError(
            f"--cells {cells[0]}x{cells[1]}: these are more than the photograph can tell, whose "
            f"pixels are {1e3 * pixel:.2g} mm wide at the mask; ask for {rows}x{columns} at most"
        )


def finest_photograph(scenario: Scenario, plane: MaskPlane, cells: tuple[int, int]) -> int:
    """Return the longer side, in pixels, of a photograph that is fine enough for cells."""
    pixel = _pixel_on_mask(scenario, plane)
    cell = min(side / count for side, count in zip(plane.sides, cells, strict=True))
    longest = max(scenario.photograph_shape)
    return next((size for size in SIZES if pixel * longest / size <= cell), SIZES[-1])


def _pixel_on_mask(scenario: Scenario, plane: MaskPlane) -> float:
    """Return how large a pixel is on the mask, in metres."""
    grid = scenario.wall_points.reshape(*scenario.photograph_shape, 3)
    pixel = max(
        float(np.linalg.norm(np.diff(grid, axis=axis), axis=2).mean())
        for axis in (0, 1)
        if grid.shape[axis] > 1
    )
    return (1 - plane.part(scenario)) * pixel


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
