"""How fine the cells of a mask may be before a photograph is looked at: its pixels tell."""

from __future__ import annotations

import numpy as np

from periscopy_sim.calibration.silhouette.cells.mask_plane import MaskPlane
from periscopy_sim.errors import SceneError
from periscopy_sim.scenario import Scenario

LONGEST = 16
"""Cells along the longer side of the rectangle, unless said otherwise."""

SIZES = (63, 96, 126)
"""Of photographs, the longer side in pixels; one is taken whose pixels are no larger than cells."""


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
        raise SceneError("a mask needs two cells at least")
    if cells[0] > rows or cells[1] > columns:
        raise SceneError(
            f"{cells[0]}x{cells[1]} cells are more than the photograph can tell, whose "
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
