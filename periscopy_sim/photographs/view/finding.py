"""The view that a photograph has of a scene's wall, found from marks measured on the wall."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from periscopy_sim.errors import PhotographError
from periscopy_sim.photographs.developing.sensor_image import SensorImage
from periscopy_sim.photographs.view.fitting import FittedView, fit_view
from periscopy_sim.photographs.view.homography import Array
from periscopy_sim.photographs.view.marks import points_as_marks, tags_as_marks
from periscopy_sim.photographs.view.tags import find_tags
from periscopy_sim.photographs.view.wall_marks import WallPoints, WallTags
from periscopy_sim.photographs.view.wall_view import WallPlane

OFF_WALL = 0.02
"""Distance from the wall that a mark may have, over the diagonal of the camera's field of view."""

FAR = 10.0
"""Distance of marks from what the camera sees, over its diagonal, that other units have."""


def find_view(
    light: SensorImage,
    plane: WallPlane,
    *,
    points: WallPoints | None = None,
    tags: WallTags | None = None,
) -> tuple[FittedView, tuple[str, ...]]:
    """Find a photograph's view of a plane wall by points or tags, and say which are not seen.

    Raises
    ------
    PhotographError
        If a mark is off the wall, or they do not tell the view: see `find_tags`, `fit_view`. The
        message names the list that they are from.
    """
    given = points or tags
    assert given is not None
    warnings: list[str] = []
    try:
        if points is not None:
            names = points.names or [f"point {k + 1}" for k in range(len(points.pixels))]
            positions = _on_wall(points.positions, plane, names)
            marks = points_as_marks(points.pixels, positions, names)
        if tags is not None:
            seen = find_tags(light.values, tags.ids)
            corners = light.cell * seen.corners
            missing = sorted(set(tags.ids.tolist()) - set(tags.ids[seen.places].tolist()))
            if missing:
                numbers = ", ".join(map(str, missing))
                warnings.append(f"{tags.source}: tags {numbers} are not seen in the photograph")
            names = [f"tag {number}" for number in tags.ids[seen.places]]
            centers = _on_wall(tags.centers[seen.places], plane, names)
            marks = tags_as_marks(corners, centers, tags.sizes[seen.places], names)
        rows, columns = light.size
        return fit_view(marks, (light.cell * rows, light.cell * columns)), tuple(warnings)
    except PhotographError as error:
        if given.source in str(error):
            raise
        raise PhotographError(f"{given.source}: {error}") from None


def _on_wall(positions: Array, plane: WallPlane, names: Sequence[str]) -> Array:
    """Return where marks are in the wall's plane; refuse one that is off it."""
    if not np.isfinite(positions).all():
        raise PhotographError("a mark's position is not finite; give metres")
    heights = plane.heights(positions)
    extent = np.linalg.norm(np.ptp(plane.pixel_corners(), axis=0))
    worst = int(np.abs(heights).argmax())
    on_wall = plane.coordinates(positions)
    away = np.linalg.norm(on_wall - plane.pixel_corners().mean(axis=0), axis=1)
    if (away > FAR * extent).all():
        raise PhotographError(
            f"all marks lie {away.min():.3g} m or more from the middle of what the camera sees, "
            f"{extent:.2g} m wide; give their positions in metres, in the scene's coordinates"
        )
    if abs(heights[worst]) > OFF_WALL * extent:
        raise PhotographError(
            f"{names[worst]} lies {abs(heights[worst]):.3g} m off the scene's wall, more than "
            f"{OFF_WALL:.0%} of the field of view; measure it in the scene's coordinates, or move "
            "the scene's wall"
        )
    return on_wall
