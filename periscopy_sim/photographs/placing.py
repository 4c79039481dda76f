"""Where a photograph shows the pixels of a scene's film, found by marks on the wall."""

from collections.abc import Sequence
from dataclasses import dataclass, field

import numpy as np

from periscopy_sim.errors import PhotographError
from periscopy_sim.photograph import Mask
from periscopy_sim.photographs.develop import SensorImage
from periscopy_sim.photographs.marks import Marks, WallPoints, WallTags, find_tags
from periscopy_sim.photographs.view_fit import FittedView, fit_view
from periscopy_sim.photographs.wall_view import WallPlane, project, wall_plane
from periscopy_sim.scenario import Array, Scenario

PAPER = 1.5
"""Side of the paper around a tag over the tag's own; the film's pixels on it are not used."""

OFF_WALL = 0.02
"""Distance of marks from the wall that counts as on it, over the diagonal of the field of view."""


@dataclass(frozen=True, eq=False)
class PlacedFilm:
    """The film of a scene's camera in a photograph.

    `placement` is the largest standard error with which the marks place the film's pixels, in such
    pixels.
    """

    view: FittedView = field(repr=False)  # how the photograph shows the wall
    plane: WallPlane = field(repr=False)  # the wall, and where the film's pixels lie in it
    corners: Array = field(repr=False)  # (rows + 1, columns + 1, 2) of pixels: column and row
    coverage: float  # pixels of the photograph that a median pixel of the film covers
    placement: float
    missing: tuple[int, ...] = ()  # numbers of the tags that the photograph does not show

    def beneath_tags(self) -> Mask:
        """Return the film's pixels that the papers of tags reach into, (rows, columns) bool."""
        hidden = np.zeros(self.plane.shape, bool)
        for tag in self.view.places if self.view.marks.are_tags else ():
            middle = tag.mean(axis=0)
            on_film = project(np.linalg.inv(self.plane.film), middle + PAPER * (tag - middle))
            left, top = np.maximum(np.floor(on_film.min(axis=0)).astype(int), 0)
            right, bottom = np.maximum(np.floor(on_film.max(axis=0)).astype(int) + 1, 0)
            hidden[top:bottom, left:right] = True
        return hidden


def place_film(light: SensorImage, scenario: Scenario, marks: WallPoints | WallTags) -> PlacedFilm:
    """Find the pixels of a scene's film in any camera's photograph, by marks on the wall.

    A PhotographError names the list of marks if they do not show the view, see `find_tags` and
    `fit_view`, one is off the wall, or part of the film lies behind the photograph's camera. A wall
    that is not plane is a SceneError, see `wall_plane`.
    """
    plane = wall_plane(scenario)
    rows, columns = plane.shape
    on_wall, missing = plane.pixel_corners(), ()
    try:
        if isinstance(marks, WallPoints):
            names = marks.names or [f"point {k + 1}" for k in range(len(marks.pixels))]
            positions = _on_wall(marks.positions, plane, names)
            found = Marks.of_points(marks.pixels, positions, names)
        else:
            places, corners = find_tags(light.values, marks.ids)
            missing = tuple(sorted(set(marks.ids.tolist()) - set(marks.ids[places].tolist())))
            names = [f"tag {number}" for number in marks.ids[places]]
            positions = _on_wall(marks.centers[places], plane, names)
            found = Marks.of_tags(light.cell * corners, positions, marks.sizes[places], names)
        view = fit_view(found, (light.cell * light.size[0], light.cell * light.size[1]))
        if not view.view.shows(on_wall):
            raise PhotographError(
                "the marks put part of the camera's field of view behind the photograph's camera, "
                "or beyond its lens; check them, and the scene's camera"
            )
    except PhotographError as error:
        named = marks.source in str(error)
        raise error if named else PhotographError(f"{marks.source}: {error}") from None
    on_sensor = view.view.pixels_of(on_wall).reshape(rows + 1, columns + 1, 2) / light.cell
    coverage = _coverage(on_sensor)
    placement = view.standard_error(on_wall) / (light.cell * np.sqrt(coverage))
    return PlacedFilm(view, plane, on_sensor, coverage, float(placement), missing)


def _on_wall(positions: Array, plane: WallPlane, names: Sequence[str]) -> Array:
    """Return where marks are in the wall's plane, (n, 2); raise if one is off it."""
    local = plane.coordinates(positions)
    extent = float(np.linalg.norm(np.ptp(plane.pixel_corners(), axis=0)))
    worst = int(np.abs(local[:, 2]).argmax())
    if not (off := abs(local[worst, 2])) <= OFF_WALL * extent:
        raise PhotographError(
            f"{names[worst]} lies {off:.3g} m off the scene's wall, more than {OFF_WALL:.0%} of "
            "the field of view; measure it in metres, in the scene's coordinates"
        )
    return local[:, :2]


def _coverage(corners: Array) -> float:
    """Return the median area of quadrilaterals, half the cross product of their diagonals."""
    falling, rising = corners[1:, 1:] - corners[:-1, :-1], corners[:-1, 1:] - corners[1:, :-1]
    cross = falling[..., 0] * rising[..., 1] - falling[..., 1] * rising[..., 0]
    return float(np.median(np.abs(cross)) / 2)
