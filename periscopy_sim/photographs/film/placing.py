"""Where a photograph shows the pixels of a scene's film, as marks on the wall tell it."""

from __future__ import annotations

from dataclasses import dataclass, field

import numpy as np

from periscopy_sim.errors import PhotographError
from periscopy_sim.photographs.developing.sensor_image import SensorImage
from periscopy_sim.photographs.film.resampling import Mask
from periscopy_sim.photographs.view.finding import find_view
from periscopy_sim.photographs.view.fitting import FittedView
from periscopy_sim.photographs.view.homography import Array
from periscopy_sim.photographs.view.wall_marks import WallPoints, WallTags
from periscopy_sim.photographs.view.wall_view import WallPlane, wall_plane
from periscopy_sim.scenario import Scenario

PAPER = 1.5
"""Side of the paper around a tag over the tag's own, which is left out of the photograph."""


@dataclass(frozen=True, eq=False)
class PlacedFilm:
    """The film of a scene's camera as a photograph shows it.

    Attributes
    ----------
    view
        How the photograph shows the wall.
    plane
        The wall, and where the film's pixels lie in it.
    corners
        (rows + 1, columns + 1, 2) column and row in the photograph of the pixels' corners.
    coverage
        Pixels of the photograph that a median pixel of the film covers.
    placement
        The largest standard error with which the marks place the film's pixels, in such pixels.
    warnings
        Which tags are not seen, one line.
    """

    view: FittedView = field(repr=False)
    plane: WallPlane = field(repr=False)
    corners: Array = field(repr=False)
    coverage: float
    placement: float
    warnings: tuple[str, ...] = ()

    def beneath_tags(self) -> Mask:
        """Return the film's pixels that the papers of tags reach into, (rows, columns) bool."""
        hidden = np.zeros(self.plane.shape, bool)
        corners = self.view.corners.reshape(-1, 4, 2)
        middles = corners.mean(axis=1, keepdims=True)
        papers = middles + PAPER * (corners - middles)
        for paper in papers:
            on_film = self.plane.pixels_of(paper)
            frame = np.stack([on_film.min(axis=0), on_film.max(axis=0)])
            (left, top), (right, bottom) = np.floor(frame).astype(int)
            hidden[max(top, 0) : max(bottom + 1, 0), max(left, 0) : max(right + 1, 0)] = True
        return hidden


def place_film(
    light: SensorImage,
    scenario: Scenario,
    *,
    points: WallPoints | None = None,
    tags: WallTags | None = None,
) -> PlacedFilm:
    """Find the pixels of a scene's film in any camera's photograph, by points or tags on the wall.

    Raises
    ------
    PhotographError
        If both are given or the marks do not tell the view, see `find_view`, or part of the film
        lies behind the photograph's camera.
    SceneError
        If the wall is not plane.
    """
    if points is not None and tags is not None:
        raise PhotographError("points and tags both tell the view; give one of them")
    plane = wall_plane(scenario)
    view, warnings = find_view(light, plane, points=points, tags=tags)
    corners = _corners(plane, view) / light.cell
    coverage = _coverage(corners)
    side = light.cell * np.sqrt(coverage)  # of the film's pixels, in those of the sensor
    placement = float(view.standard_error(plane.pixel_corners()) / side)
    return PlacedFilm(view, plane, corners, coverage, placement, warnings)


def _corners(plane: WallPlane, view: FittedView) -> Array:
    """Return (rows + 1, columns + 1, 2) places on the sensor of the film's pixels' corners."""
    rows, columns = plane.shape
    on_wall = plane.pixel_corners()
    if not view.view.shows(on_wall):
        raise PhotographError(
            "the marks put part of the camera's field of view behind the photograph's camera, or "
            "beyond its lens; check them, and the scene's camera"
        )
    return view.view.pixels_of(on_wall).reshape(rows + 1, columns + 1, 2)


def _coverage(corners: Array) -> float:
    """Return the median area of quadrilaterals, half the cross product of their diagonals."""
    falling, rising = corners[1:, 1:] - corners[:-1, :-1], corners[:-1, 1:] - corners[1:, :-1]
    areas = np.abs(falling[..., 0] * rising[..., 1] - falling[..., 1] * rising[..., 0]) / 2
    return float(np.median(areas))
