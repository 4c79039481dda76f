"""From any camera's photograph to the pixels of a scene's camera."""

from collections.abc import Sequence
from dataclasses import dataclass, field
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from periscopy_sim.errors import PhotographError
from periscopy_sim.numerics import Array, Mask
from periscopy_sim.photographs import develop, wall_view
from periscopy_sim.photographs.resampling import DEFECTIVE, EXCLUDED, AreaMap, block_corners
from periscopy_sim.view import Geometry

PAPER_SIDE = 1.5
"""Side of the paper around a tag over the tag's own; the film's pixels on it are not used."""

OFF_WALL = 0.02
"""Distance of marks from the wall that counts as on it, over the diagonal of the field of view."""


@dataclass(frozen=True, eq=False)
class PlacedFilm:
    """The film of a scene's camera in a photograph.

    `placement` is the largest standard error with which the marks place the film's pixels, in such
    pixels.
    """

    view: wall_view.FittedView = field(repr=False)  # how the photograph shows the wall
    plane: wall_view.WallPlane = field(
        repr=False
    )  # the wall, and where the film's pixels lie in it
    corners: Array = field(repr=False)  # (rows + 1, columns + 1, 2) of pixels: column and row
    coverage: float  # pixels of the photograph that a median pixel of the film covers
    placement: float
    missing: tuple[int, ...] = ()  # numbers of the tags that the photograph does not show

    def beneath_tags(self) -> Mask:
        """Return the film's pixels that the papers of tags reach into, (rows, columns) bool."""
        hidden = np.zeros(self.plane.shape, bool)
        for tag in self.view.places if self.view.marks.are_tags else ():
            middle = tag.mean(axis=0)
            on_film = wall_view.project(
                np.linalg.inv(self.plane.film), middle + PAPER_SIDE * (tag - middle)
            )
            left, top = np.maximum(np.floor(on_film.min(axis=0)).astype(int), 0)
            right, bottom = np.maximum(np.floor(on_film.max(axis=0)).astype(int) + 1, 0)
            hidden[top:bottom, left:right] = True
        return hidden


def place_film(
    light: develop.SensorImage, scenario: Geometry, marks: wall_view.WallPoints | wall_view.WallTags
) -> PlacedFilm:
    """Find the pixels of a scene's film in any camera's photograph, by marks on the wall.

    A PhotographError names the list of marks if they do not show the view, see `find_tags` and
    `fit_view`, one is off the wall, or part of the film lies behind the photograph's camera. A wall
    that is not plane is a SceneError, see `wall_plane`.
    """
    plane = wall_view.wall_plane(scenario)
    rows, columns = plane.shape
    on_wall, missing = plane.pixel_corners(), ()
    try:
        if isinstance(marks, wall_view.WallPoints):
            names = marks.names or [f"point {k + 1}" for k in range(len(marks.pixels))]
            positions = _on_wall(marks.positions, plane, names)
            known = wall_view.Marks.of_points(marks.pixels, positions, names)
        else:
            places, corners = wall_view.find_tags(light.values, marks.ids)
            missing = tuple(sorted(set(marks.ids.tolist()) - set(marks.ids[places].tolist())))
            names = [f"tag {number}" for number in marks.ids[places]]
            positions = _on_wall(marks.centers[places], plane, names)
            known = wall_view.Marks.of_tags(
                light.cell * corners, positions, marks.sizes[places], names
            )
        view = wall_view.fit_view(known, (light.cell * light.size[0], light.cell * light.size[1]))
        if not view.view.shows(on_wall):
            raise PhotographError(
                "the points or tags put part of the camera's field of view behind the photograph's "
                "camera, or beyond its lens; check them, and the scene's camera"
            )
    except PhotographError as error:
        named = marks.source in str(error)
        raise error if named else PhotographError(f"{marks.source}: {error}") from None
    on_sensor = view.view.pixels_of(on_wall).reshape(rows + 1, columns + 1, 2) / light.cell
    coverage = _coverage(on_sensor)
    placement = view.standard_error(on_wall) / (light.cell * np.sqrt(coverage))
    return PlacedFilm(view, plane, on_sensor, coverage, float(placement), missing)


def _on_wall(positions: Array, plane: wall_view.WallPlane, names: Sequence[str]) -> Array:
    """Return the places of marks in the wall's plane, (n, 2); raise if one is off the plane."""
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


LARGEST_PLACEMENT_ERROR = 0.5
"""Standard error, in pixels of the film, with which marks should place a photograph."""

NEGATIVE_FRACTION = 0.02
"""Fraction of pixels below the black level that causes a warning; well exposed ones have none."""


@dataclass(frozen=True, eq=False)
class Prepared:
    """A photograph in the pixels of a scene's camera.

    Attributes
    ----------
    values
        (rows, columns, 3) float64, linear light; NaN outside the mask.
    mask
        (rows, columns) bool, True where the photograph measures the wall.
    defects
        Single dead or hot pixels of the photograph that the averages leave out.
    coverage
        Pixels of the photograph that an average new pixel covers.
    view
        View of the wall in the photograph, from marks; None without marks.
    placement
        The largest standard error with which marks place the new pixels, in new pixels; 0 without
        marks.
    warnings
        Assumptions, one line each.
    """

    values: Array = field(repr=False)
    mask: Mask = field(repr=False)
    defects: int
    coverage: float
    view: wall_view.FittedView | None
    placement: float = 0.0
    warnings: tuple[str, ...] = ()

    def record(self) -> dict[str, object]:
        """Return the numbers of the view, and of the pixels left out, for metadata."""
        left_out: dict[str, object] = {
            "pixels_left_out": int(np.count_nonzero(~self.mask)),
            "defects_left_out": self.defects,
        }
        if self.view is None:
            return left_out
        return left_out | self.view.record(self.placement)


class FilmPixels:
    """The pixels of a scene's film in photographs of a camera at rest, found in one of them.

    The photograph must fit the scene, see `prepare`; its saturated pixels do not matter.

    Attributes
    ----------
    mask
        (rows, columns) bool, True where the film's pixels measure the wall.
    defects, warnings
        As of `Prepared`.
    film
        Where marks place the film; None without marks.
    coverage
        Pixels of a photograph that an average pixel of the film covers.
    """

    def __init__(
        self,
        light: develop.SensorImage,
        scenario: Geometry,
        marks: wall_view.WallPoints | wall_view.WallTags | None = None,
        mask: Mask | None = None,
    ) -> None:
        shape = scenario.photograph_shape
        self.film, self.warnings = None, list[str]()
        if marks is not None:
            self.film = place_film(light, scenario, marks)
            missing = self.film.missing
            self.warnings = [f"the photograph does not show tag {number}" for number in missing]
            if self.film.placement > LARGEST_PLACEMENT_ERROR:
                self.warnings.append(
                    f"the points or tags place the photograph to {self.film.placement:.1f} of the "
                    "scene's pixels only, where it is worst; measure more of them, further apart"
                )
        elif light.size != tuple(light.size[0] // shape[0] * side for side in shape):
            raise PhotographError(
                f"{light.size[0]} x {light.size[1]} pixels (rows x columns) do not average to the "
                f"{shape[0]} x {shape[1]} of the scene's camera by whole square blocks; change its "
                "film, crop the photograph, or give points or tags of the wall"
            )
        on_photograph, on_film = None, np.ones(shape, bool)
        if mask is not None and mask.shape == shape != light.size:
            on_film = mask
        elif mask is not None:
            on_photograph = develop.mask_of_pixels(mask, light)
        found = develop.defective_pixels(light.values, on_photograph)
        single = (found.dead | found.hot) & ~light.saturated
        self.defects = int(np.count_nonzero(single))
        states = np.uint8(DEFECTIVE) * single
        if on_photograph is not None:
            states[~on_photograph] = EXCLUDED
        corners = self.film.corners if self.film else block_corners(light.size, shape)
        covered = float(np.prod(light.size) / np.prod(shape))
        self.coverage = self.film.coverage if self.film else covered
        self._areas = AreaMap(states, corners)
        beneath = self.film.beneath_tags() if self.film else False
        self.mask = _measuring(self._areas.usable & on_film & ~np.asarray(beneath))

    def average(
        self, values: NDArray[Any], table: NDArray[np.float32] | None = None
    ) -> NDArray[Any]:
        """Return a photograph averaged to the film's pixels; see `AreaMap.average`."""
        return self._areas.average(values, table)


def _measuring(used: Mask) -> Mask:
    """Return which of the film's pixels measure the wall; a PhotographError if there is none."""
    if not used.any():
        raise PhotographError(
            "no pixel of the scene's camera measures the wall: all are outside of the photograph, "
            "saturated or masked; check the points or tags and the exposure"
        )
    return used


def prepare(
    photograph: develop.SensorImage | ArrayLike,
    scenario: Geometry,
    *,
    marks: wall_view.WallPoints | wall_view.WallTags | None = None,
    mask: Mask | None = None,
) -> Prepared:
    """Bring a photograph to the pixels of a scene's camera.

    Without marks the scene's camera is the photograph's, and whole blocks of pixels are
    averaged to its film. With them the photograph may be any camera's: the marks show its view of
    the wall, which must be plane, and each new pixel averages all that it covers. A camera measures
    radiance, and a diffuse wall's is the same in every direction: the slant needs no factor. Single
    dead and hot pixels are left out of the averages.

    Parameters
    ----------
    photograph
        (rows, columns, 3), linear in light; see `develop`.
    scenario
        The scene.
    marks
        Points or tags on the wall.
    mask
        (rows, columns) bool, where the wall is used, of the photograph's size or of the film's, or
        of its sensor's where its pixels are the cells of a mosaic.

    Raises
    ------
    PhotographError
        If the photograph does not average to the film's size by whole square blocks, or the marks
        do not show its view: see `place_film`.
    SceneError
        If there are marks and the wall is not plane.
    """
    light = develop.sensor_image(photograph, "the photograph")
    pixels = FilmPixels(light, scenario, marks, mask)
    film, warnings = pixels.film, pixels.warnings
    values = pixels.average(light.infinite)
    full = np.isinf(values).any(axis=2)
    used = _measuring(pixels.mask & ~full)
    if (below := float(np.mean(values[used].min(axis=1) < 0))) >= NEGATIVE_FRACTION:
        warnings.append(
            f"{100 * below:.0f} % of the pixels are below the black level; check it, or the dark "
            "frame"
        )
    return Prepared(
        values=np.where(used[..., np.newaxis], values, np.nan),
        mask=used,
        defects=pixels.defects,
        coverage=pixels.coverage,
        view=film.view if film else None,
        placement=film.placement if film else 0.0,
        warnings=tuple(warnings),
    )
