"""From any camera's photograph to the pixels of a scene's camera."""

from dataclasses import dataclass, field

import numpy as np
from numpy.typing import ArrayLike, NDArray

from periscopy_sim.errors import PhotographError
from periscopy_sim.photograph import Mask
from periscopy_sim.photographs.defects import defective_pixels
from periscopy_sim.photographs.develop import SensorImage, mask_of_pixels, sensor_image
from periscopy_sim.photographs.marks import WallPoints, WallTags
from periscopy_sim.photographs.placing import place_film
from periscopy_sim.photographs.resampling import Flaw, average_areas, block_corners
from periscopy_sim.photographs.view_fit import FittedView
from periscopy_sim.scenario import Array, Scenario

PLACED = 0.5
"""Standard error, in pixels of the film, with which marks should place a photograph."""

BELOW = 0.02
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
    flaws
        (rows, columns) uint8, the `Flaw`s of each pixel: why the mask excludes it.
    defects
        Single dead or hot pixels of the photograph that the averages leave out.
    coverage
        Pixels of the photograph that an average new pixel covers.
    view
        How the photograph shows the wall, by marks; None without marks.
    placement
        The largest standard error with which marks place the new pixels, in new pixels; 0 without
        marks.
    warnings
        What had to be assumed, one line each.
    """

    values: Array = field(repr=False)
    mask: Mask = field(repr=False)
    flaws: NDArray[np.uint8] = field(repr=False)
    defects: int
    coverage: float
    view: FittedView | None
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
        return {
            **left_out,
            "view_placement": self.placement,
            "view_residual_pixels": self.view.rms,
            "view_distortion": " ".join(map(repr, self.view.view.distortion)) or "none",
            "view_homography": " ".join(map(repr, self.view.view.homography.ravel().tolist())),
        }


def prepare(
    photograph: SensorImage | ArrayLike,
    scenario: Scenario,
    *,
    marks: WallPoints | WallTags | None = None,
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
    light = sensor_image(photograph, "the photograph")
    shape = scenario.photograph_shape
    film, warnings = None, []
    if marks is not None:
        film = place_film(light, scenario, marks)
        warnings = [f"the photograph does not show tag {number}" for number in film.missing]
        if film.placement > PLACED:
            warnings.append(
                f"the marks place the photograph to {film.placement:.1f} of the scene's pixels "
                "only, where it is worst; measure more of them, further apart"
            )
    elif light.size != tuple(light.size[0] // shape[0] * side for side in shape):
        raise PhotographError(
            f"{light.size[0]} x {light.size[1]} pixels (rows x columns) do not average to the "
            f"{shape[0]} x {shape[1]} of the scene's camera by whole square blocks; change its "
            "film, crop the photograph, or give marks on the wall"
        )
    on_photograph, on_film = None, np.ones(shape, bool)
    if mask is not None and mask.shape == shape != light.size:
        on_film = mask
    elif mask is not None:
        on_photograph = mask_of_pixels(mask, light)
    defects = defective_pixels(light.values, on_photograph)
    single = (defects.dead | defects.hot) & ~light.saturated
    flaws = np.uint8(Flaw.SATURATED) * light.saturated | np.uint8(Flaw.DEFECTIVE) * single
    if on_photograph is not None:
        flaws |= np.uint8(Flaw.MASKED) * ~on_photograph
    corners = film.corners if film else block_corners(light.size, shape)
    values, found = average_areas(light.values, flaws, corners)
    found |= np.uint8(Flaw.MASKED) * ~on_film
    if film:
        found |= np.uint8(Flaw.TAG) * film.beneath_tags()
    used = (found & ~np.uint8(Flaw.DEFECTIVE)) == 0
    if not used.any():
        raise PhotographError(
            "no pixel of the scene's camera measures the wall: all are outside of the photograph, "
            "saturated or masked; check the marks and the exposure"
        )
    if (below := float(np.mean(values[used].min(axis=1) < 0))) >= BELOW:
        warnings.append(
            f"{100 * below:.0f} % of the pixels are below the black level; check it, or the dark "
            "frame"
        )
    return Prepared(
        values=np.where(used[..., np.newaxis], values, np.nan),
        mask=used,
        flaws=found,
        defects=int(np.count_nonzero(single)),
        coverage=film.coverage if film else float(np.prod(light.size) / np.prod(shape)),
        view=film.view if film else None,
        placement=film.placement if film else 0.0,
        warnings=tuple(warnings),
    )
