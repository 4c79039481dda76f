"""From any camera's photograph to the pixels of a scene's camera."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import dataclass, field, replace

import numpy as np
from numpy.typing import ArrayLike, NDArray

from periscopy_sim.errors import PhotographError
from periscopy_sim.photographs.calibration_frames import check_another_frame
from periscopy_sim.photographs.defects import defective_pixels
from periscopy_sim.photographs.exposures import (
    SensorImage,
    average,
    check_same_size,
    evenly_sensitive,
    merge,
    sensor_image,
    without_offset,
)
from periscopy_sim.photographs.film_size import film_doubts, films_of_blocks
from periscopy_sim.photographs.homography import Array
from periscopy_sim.photographs.marks import points_as_marks, tags_as_marks
from periscopy_sim.photographs.resampling import (
    Flaw,
    Mask,
    average_blocks,
    average_quadrilaterals,
)
from periscopy_sim.photographs.tags import find_tags
from periscopy_sim.photographs.view_fitting import FittedView, fit_view
from periscopy_sim.photographs.wall_marks import WallPoints, WallTags
from periscopy_sim.photographs.wall_view import WallPlane, wall_plane
from periscopy_sim.scenario import Scenario

OFF_WALL = 0.02
"""Distance from the wall that a mark may have, over the diagonal of the camera's field of view."""

FAR = 10.0
"""Distance of marks from what the camera sees, over its diagonal, that other units have."""

_BAND = 1 << 20  # pixels in which defects are looked for at once
_REACH = 4  # rows beyond a band that are looked at, too

PAPER = 1.5
"""Side of the paper around a tag over the tag's own, which is left out of the photograph."""


@dataclass(frozen=True, eq=False)
class Prepared:
    """A photograph in the pixels of a scene's camera.

    Attributes
    ----------
    values
        (rows, columns, 3) float64, linear light; NaN where the mask leaves it out.
    mask
        (rows, columns) bool, True where the wall is measured.
    outside, saturated, masked, markers
        (rows, columns) bool, why it is not: beyond the photograph, saturated in every exposure,
        left out by the photograph's own mask, or beneath a tag.
    defects
        Single dead or hot pixels of the photograph that were left out of the averages.
    coverage
        Pixels of the photograph that an average new pixel covers.
    view
        How the photograph shows the wall, where marks told that.
    placement
        The largest standard error with which marks place the new pixels, in new pixels; 0 where
        the scene's camera is the photograph's.
    warnings
        What had to be assumed, one line each.
    """

    values: Array = field(repr=False)
    mask: Mask = field(repr=False)
    outside: Mask = field(repr=False)
    saturated: Mask = field(repr=False)
    masked: Mask = field(repr=False)
    markers: Mask = field(repr=False)
    defects: int
    coverage: float
    view: FittedView | None
    placement: float = 0.0
    warnings: tuple[str, ...] = ()


def develop(
    photographs: Iterable[SensorImage | ArrayLike],
    *,
    times: Sequence[float] | None = None,
    black: float = 0.0,
    dark: SensorImage | ArrayLike | None = None,
    flat: SensorImage | ArrayLike | None = None,
    mask: Mask | None = None,
) -> SensorImage:
    """Return one picture, linear in light, from what a camera took of one view.

    Parameters
    ----------
    photographs
        (rows, columns, 3) each. They are averaged; with `times` they are merged.
    times
        Exposure time of each, in any unit; the result is light per unit of time.
    black
        The camera's black level, taken off every photograph and the flat field.
    dark
        A photograph with the lens covered, taken off likewise. Give one of the two.
    flat
        A photograph of an evenly lit white surface, to divide by.
    mask
        (rows, columns) bool, where the wall is used; elsewhere the flat field may be dark.

    Raises
    ------
    PhotographError
        If sizes differ, a value is not finite, the flat field is dark or saturated, or it or the
        dark frame is one of the photographs.
    """
    offset: NDArray[np.float32] | float = black
    spoiled: Mask | bool = False
    frames: list[tuple[SensorImage, str]] = []
    if dark is not None:
        if black:
            raise PhotographError("a dark frame holds the black level; give one of the two")
        darkness = _as_sensor_image(dark, "the dark frame")
        offset, spoiled = darkness.values, darkness.saturated
        frames.append((darkness, "the dark frame"))
    if flat is not None:
        even = _as_sensor_image(flat, "the flat field")
        frames.append((even, "the flat field"))

    def taken() -> Iterable[SensorImage]:
        for k, each in enumerate(photographs):
            exposure = _as_sensor_image(each, f"photograph {k}")
            for frame, name in frames:
                check_another_frame(frame, exposure, name)
            if not np.isscalar(offset):
                check_same_size(np.shape(offset)[:2], exposure.size, "the dark frame")
            exposure = replace(exposure, saturated=exposure.saturated | spoiled)
            yield without_offset(exposure, offset)

    light = average(taken(), "photographs") if times is None else merge(list(taken()), times)
    if flat is None:
        return light
    check_same_size(even.size, light.size, "the flat field")
    even = without_offset(even, offset)
    return evenly_sensitive(light, even, mask)


def _as_sensor_image(given: SensorImage | ArrayLike, name: str) -> SensorImage:
    return given if isinstance(given, SensorImage) else sensor_image(given, name)


def prepare(
    photograph: SensorImage | ArrayLike,
    scenario: Scenario,
    *,
    points: WallPoints | None = None,
    tags: WallTags | None = None,
    mask: Mask | None = None,
) -> Prepared:
    """Bring a photograph to the pixels of a scene's camera.

    Without points and tags the scene's camera is the photograph's, and whole blocks of pixels are
    averaged to its film. With them the photograph may be any camera's: its view of the wall, which
    must be plane, is found from the marks, and each new pixel averages all that it covers. Radiance
    is what a camera measures, and a diffuse wall's is the same in every direction: no factor for
    the slant is due. Single dead and hot pixels are left out of the averages.

    Parameters
    ----------
    photograph
        (rows, columns, 3), linear in light; see `develop`.
    scenario
        The scene.
    points, tags
        Marks on the wall, at most one of the two.
    mask
        (rows, columns) bool, where the wall is used, of the photograph's size or of the film's, or
        of its sensor's where its pixels are the cells of a mosaic.

    Returns
    -------
    Prepared

    Raises
    ------
    PhotographError
        If the photograph does not average to the film's size by whole square blocks, or the marks
        do not tell its view: see `fit_view`, `find_tags`.
    SceneError
        If there are marks and the wall is not plane.
    """
    light = _as_sensor_image(photograph, "the photograph")
    on_film = np.ones(scenario.photograph_shape, bool)
    has_mask = mask is not None
    if mask is not None and mask.shape == on_film.shape != light.size:
        on_film = mask
        mask = None
    if mask is not None:
        mask = mask_of_pixels(mask, light)
    if points is not None and tags is not None:
        raise PhotographError("points and tags both tell the view; give one of them")
    single = _single_defects(light, mask)
    flaws = np.uint8(Flaw.SATURATED) * light.saturated | np.uint8(Flaw.DEFECTIVE) * single
    if mask is not None:
        flaws |= np.uint8(Flaw.MASKED) * ~mask
    markers = np.zeros(scenario.photograph_shape, bool)
    view, placement, warnings = None, 0.0, []
    if points is None and tags is None:
        check_blocks(light.size, scenario.photograph_shape)
        resampled = average_blocks(light.values, flaws, scenario.photograph_shape)
        coverage = float(np.prod(light.size) / np.prod(scenario.photograph_shape))
    else:
        plane = wall_plane(scenario)
        view, missing = _view(light, plane, points, tags)
        warnings += missing
        corners = _corners(plane, view) / light.cell
        resampled = average_quadrilaterals(light.values, flaws, corners)
        coverage = _coverage(corners)
        if tags is not None:
            markers = _beneath(view, plane)
        placement = _placement(view, plane, light.cell * np.sqrt(coverage))
        warnings += film_doubts(placement, coverage, float(resampled.outside.mean()))
    used = resampled.used & ~markers & on_film
    if not used.any():
        raise PhotographError(
            "no pixel of the scene's camera measures the wall: all are outside of the photograph, "
            "saturated or masked; check the marks and the exposure"
        )
    masked = ~on_film | ((resampled.flaws & Flaw.MASKED) != 0)
    if has_mask and not masked.any():
        warnings.append(
            "the mask leaves out no pixel of the scene's film; paint black what is not wall"
        )
    return Prepared(
        values=np.where(used[..., np.newaxis], resampled.values, np.nan),
        mask=used,
        outside=resampled.outside,
        saturated=(resampled.flaws & Flaw.SATURATED) != 0,
        masked=masked,
        markers=markers,
        defects=int(np.count_nonzero(single)),
        coverage=coverage,
        view=view,
        placement=placement,
        warnings=tuple(warnings),
    )


def sample_film(
    photograph: SensorImage | ArrayLike,
    scenario: Scenario,
    *,
    points: WallPoints | None = None,
    tags: WallTags | None = None,
) -> tuple[float, float]:
    """Return the `coverage` and the `placement` that `prepare` would find of a photograph.

    The parameters are those of `prepare`, one of points and tags is given; so are the errors.
    """
    light = _as_sensor_image(photograph, "the photograph")
    plane = wall_plane(scenario)
    view, _ = _view(light, plane, points, tags)
    coverage = _coverage(_corners(plane, view) / light.cell)
    return coverage, _placement(view, plane, light.cell * np.sqrt(coverage))


def mask_of_pixels(mask: Mask, light: SensorImage) -> Mask:
    """Return a mask of a photograph's pixels from one of its sensor's; one of another size fails.

    Of a cell of a mosaic, all pixels must be used.
    """
    rows, columns = light.size
    on_sensor = light.cell * rows, light.cell * columns
    if light.cell > 1 and mask.shape == on_sensor:
        cells = mask.reshape(rows, light.cell, columns, light.cell)
        return np.asarray(cells.all(axis=(1, 3)))
    check_same_size(mask.shape, light.size, "the mask")
    return mask


def _single_defects(light: SensorImage, mask: Mask | None) -> Mask:
    """Return where single pixels are dead or hot; by bands of rows, which bounds the memory."""
    rows, columns = light.size
    height = max(_BAND // columns, 4 * _REACH)
    found = np.zeros(light.size, bool)
    for start in range(0, rows, height):
        first = max(min(start, rows - height) - _REACH, 0)
        band = slice(first, start + height + _REACH)
        defects = defective_pixels(light.values[band], None if mask is None else mask[band])
        single = defects.dead | defects.hot
        found[start : start + height] = single[start - first : start - first + height]
    return found & ~light.saturated


def check_blocks(size: tuple[int, int], shape: tuple[int, int]) -> None:
    """Refuse a photograph of (rows, columns) that does not average to a film by square blocks."""
    films = films_of_blocks(size)
    if shape in films.values():
        return
    sizes = [f"{rows}x{columns}" for rows, columns in list(films.values())[:12]]
    raise PhotographError(
        f"{size[0]} x {size[1]} pixels (rows x columns) do not average to the {shape[0]} x "
        f"{shape[1]} of the scene's camera by whole square blocks; its film may have "
        f"{', '.join(sizes)}: change it in the scene, or crop the photograph; of another camera "
        "than the scene's, tell points of the wall by --points, or --tags"
    )


def _view(
    light: SensorImage, plane: WallPlane, points: WallPoints | None, tags: WallTags | None
) -> tuple[FittedView, list[str]]:
    """Find the photograph's view of the wall, and say which tags were not seen."""
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
        return fit_view(marks, (light.cell * rows, light.cell * columns)), warnings
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


def _corners(plane: WallPlane, view: FittedView) -> Array:
    """Return (rows + 1, columns + 1, 2) places in the photograph of the film's pixels' corners."""
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


def _placement(view: FittedView, plane: WallPlane, side: float) -> float:
    """Return the largest standard error of the film's pixels, whose side is in the photograph's."""
    return float(view.standard_error(plane.pixel_corners()) / side)


def _beneath(view: FittedView, plane: WallPlane) -> Mask:
    """Return the film's pixels that the papers of the tags reach into, (rows, columns) bool."""
    rows, columns = plane.shape
    hidden = np.zeros((rows, columns), bool)
    corners = view.corners.reshape(-1, 4, 2)
    middles = corners.mean(axis=1, keepdims=True)
    papers = middles + PAPER * (corners - middles)
    for paper in papers:
        on_film = plane.pixels_of(paper)
        frame = np.stack([on_film.min(axis=0), on_film.max(axis=0)])
        (left, top), (right, bottom) = np.floor(frame).astype(int)
        hidden[max(top, 0) : max(bottom + 1, 0), max(left, 0) : max(right + 1, 0)] = True
    return hidden
