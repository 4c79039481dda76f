"""From any camera's photograph to the pixels of a scene's camera."""

from __future__ import annotations

from dataclasses import dataclass, field

import numpy as np
from numpy.typing import ArrayLike

from periscopy_sim.errors import PhotographError
from periscopy_sim.photographs.defects import single_defects
from periscopy_sim.photographs.developing.sensor_image import (
    Mask,
    SensorImage,
    as_sensor_image,
    mask_of_pixels,
)
from periscopy_sim.photographs.film.placing import place_film
from periscopy_sim.photographs.film.resampling import (
    Array,
    Flaw,
    average_blocks,
    average_quadrilaterals,
)
from periscopy_sim.photographs.film.size import check_blocks, film_doubts
from periscopy_sim.photographs.view.fitting import FittedView
from periscopy_sim.photographs.view.wall_marks import WallPoints, WallTags
from periscopy_sim.scenario import Scenario


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
        do not tell its view: see `place_film`.
    SceneError
        If there are marks and the wall is not plane.
    """
    light = as_sensor_image(photograph, "the photograph")
    shape = scenario.photograph_shape
    on_film = np.ones(shape, bool)
    has_mask = mask is not None
    if mask is not None and mask.shape == on_film.shape != light.size:
        on_film = mask
        mask = None
    if mask is not None:
        mask = mask_of_pixels(mask, light)
    film = None
    if points is None and tags is None:
        check_blocks(light.size, shape)
    else:
        film = place_film(light, scenario, points=points, tags=tags)
    single = single_defects(light.values, mask) & ~light.saturated
    flaws = np.uint8(Flaw.SATURATED) * light.saturated | np.uint8(Flaw.DEFECTIVE) * single
    if mask is not None:
        flaws |= np.uint8(Flaw.MASKED) * ~mask
    if film is None:
        resampled = average_blocks(light.values, flaws, shape)
        coverage, placement = float(np.prod(light.size) / np.prod(shape)), 0.0
        markers, warnings = np.zeros(shape, bool), []
    else:
        resampled = average_quadrilaterals(light.values, flaws, film.corners)
        coverage, placement, markers = film.coverage, film.placement, film.beneath_tags()
        outside = float(resampled.outside.mean())
        warnings = [*film.warnings, *film_doubts(placement, coverage, outside)]
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
        view=film.view if film else None,
        placement=placement,
        warnings=tuple(warnings),
    )
