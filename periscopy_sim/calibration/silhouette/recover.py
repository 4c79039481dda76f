"""Find the silhouette of an unmeasured occluder: behind known pictures, or with the hidden image.

The light through a flat mask is linear in the opacities of its cells. Photographs of pictures that
the monitor is known to have shown leave one descent to do (`mask`). Without such, the image is
unknown too (`unknown`), and two questions stay open: mask and image may be shifted against each
other, as far as the image's border is dark; and they may change places, each turned by half a
circle, if the image has one colour and is as bright as dark.
"""

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np
from threadpoolctl import threadpool_limits

from periscopy_sim.analytic.area_transport import area_transport, points_across
from periscopy_sim.calibration.evidence import SmoothImages
from periscopy_sim.calibration.moving_scene import LARGEST, limit_size, limit_sizes
from periscopy_sim.calibration.problem import (
    COARSE_HATS,
    MOST_PATCHES,
    ambient_basis,
    shown_light,
)
from periscopy_sim.calibration.silhouette.mask import Likelihood, Mask, MaskFit, known_pictures
from periscopy_sim.calibration.silhouette.plane import MaskPlane
from periscopy_sim.calibration.silhouette.result import Silhouette
from periscopy_sim.calibration.silhouette.shadows import CellShadows
from periscopy_sim.calibration.silhouette.unknown import STARTS, UnknownImage, search
from periscopy_sim.calibration.trust import is_significant
from periscopy_sim.errors import PhotographError, SceneError
from periscopy_sim.geometry import Geometry
from periscopy_sim.hidden import Hidden, Sizes
from periscopy_sim.numerics import Array, Image
from periscopy_sim.photograph import Photograph, of_one_wall
from periscopy_sim.rendering.scene.load import load_geometry
from periscopy_sim.scene import CAMERA, Scene
from periscopy_sim.storage.pictures import averaged_photograph
from periscopy_sim.view import View

FEW = 8
"""Cells of first descents along the longer side, at most: a letter F of 16 x 16 is found from 8 x
8. They look at a quarter of the pixels along a side that a photograph may have, later ones at half
of them or more."""

UNSEEN = 1e-2
"""Fraction of the largest cell's shadow below which a cell's is not seen."""


def recover_silhouette(
    photograph: Photograph | Image | Sequence[Photograph | Image],
    scene: str | Path | Scene,
    hidden: Sizes,
    shape: str,
    cells: tuple[int, int] | None = None,
    *,
    shown: Sequence[Image | Mapping[str, Image]] = (),
    parameters: Mapping[str, str | float] | None = None,
    camera: str = CAMERA,
    seed: int = 0,
    progress: Callable[[float], None] | None = None,
) -> Silhouette:
    """Find the silhouette of a flat occluder that nobody measured.

    Parameters
    ----------
    photograph
        A photograph as of `calibrate`; or one for each picture shown.
    scene, parameters, camera, progress
        As of `calibrate`.
    hidden
        (R, C) of the hidden image; of several surfaces a mapping of such by id. The
        search uses at most 24 patches along a side of an unknown one, 36 of a known one.
    shape
        The occluder's id. Its form does not matter, only the rectangle about it, see `MaskPlane`.
    cells
        (rows, columns) into which that is cut; by default 16 along its longer side, as square as
        they can be.
    shown
        (R, C, P) pictures that the monitor showed, linear, one for each photograph; of several
        surfaces mappings of such by id. Two of them make the silhouette far more certain than any
        unknown image.
    seed
        Seed of the random masks from which a search for an unknown image starts.

    Returns
    -------
    Silhouette
        Look at `Silhouette.doubts` first.

    Raises
    ------
    SceneError
        If there can be no mask (`MaskPlane`), it casts no shadow into view, or the scene without
        the shape has no closed form (`analytic_transport`).
    PhotographError
        If photographs are not of the camera's size, show no shadow of the shape, or are not as many
        as pictures (without these: one).
    """
    report = progress or (lambda _: None)
    scenario = load_geometry(scene, hidden, parameters, camera=camera)
    plane = MaskPlane.of(scenario, shape)
    cells, size = cells or plane.square_cells(), scenario.photograph_shape
    needed = np.ceil(max(size) / plane.pixels_a_cell(scenario, cells))
    finest = limit_size(size, int(np.clip(needed, LARGEST // 2, LARGEST)))
    photographs = [each.unmixed() for each in of_one_wall(photograph, size)]
    if len(photographs) != max(1, len(shown)):
        raise PhotographError(
            f"{len(photographs)} photographs of {len(shown)} shown pictures: give a photograph of "
            "each picture, or one photograph of an unknown one"
        )
    averaged = [averaged_photograph(each, finest) for each in photographs]
    sizes = limit_sizes(scenario.hidden, MOST_PATCHES if shown else COARSE_HATS)
    patches = Hidden.of_scene(scenario.scene, sizes)
    place = _Place(scenario, shape, plane, patches)
    # Products this small gain less from threads than these cost, see `calibrate`.
    with threadpool_limits(1):
        if shown:
            pictures = [shown_light(each, patches) for each in shown]
            end = _behind_pictures(place, cells, averaged, pictures)
        else:
            coarse = averaged_photograph(photographs[0], limit_size(size, LARGEST // 4))
            end = _behind_unknown_image(place, cells, coarse, averaged[0], seed, report)
        without = end.mask.fit(np.zeros(cells), end.fit.gain, end.likelihood)
    if not is_significant(2 * (without.objective - end.fit.objective), end.fit.opacities.size):
        raise PhotographError(
            f"the photograph shows no shadow of '{shape}' in its rectangle; its silhouette cannot "
            "be estimated"
        )
    report(1.0)
    explained, used, shadow = end.fit.explained, averaged[0].pixels, end.mask.shadows.light
    scale = float(np.sqrt(np.mean(np.square([each.used for each in averaged]))))
    residual = np.zeros((*used.shape, explained.residual.shape[2]))
    residual[used] = explained.residual[0] / scale
    unexplained, unexplained_open = (
        float(np.sqrt(np.mean(each.residual**2))) / scale for each in (explained, without.explained)
    )
    return Silhouette(
        name=shape,
        plane=plane,
        opacities=end.fit.opacities,
        seen=(shadow > UNSEEN * shadow.max()).reshape(cells),
        image=patches.image(explained.image),
        unexplained=unexplained,
        unexplained_open=unexplained_open,
        residual=residual,
        evidence=explained.cost,
        agreeing=end.agreeing,
        starts=end.starts,
    )


@dataclass(frozen=True, eq=False)
class _Place:
    """Where a mask stands, in an occluder's place, and the hidden patches."""

    scenario: Geometry
    name: str
    plane: MaskPlane
    hidden: Hidden

    def mask(self, cells: tuple[int, int], photograph: Photograph) -> tuple[Mask, Array]:
        """Return a mask before a photograph's pixels, and a basis of range(B), (M, r)."""
        used, scene, hidden = photograph.pixels, self.scenario.scene, self.hidden
        shape, camera = photograph.shape, self.scenario.view.camera
        view = View.of(scene, shape, camera=camera)
        fine = View.of(scene, shape, across=points_across(shape), camera=camera).of_pixels(used)
        A = area_transport(Geometry(replace(fine, scene=scene.without(self.name)), hidden))
        shadows = CellShadows.of(A, Geometry(view, hidden), self.plane, cells, used)
        if not shadows.light.any():
            raise SceneError(
                f"scene '{scene.path}': occluder '{self.name}' casts no shadow of the monitor into "
                "what the camera sees of the wall, wherever in its rectangle it is opaque"
            )
        return Mask.of(cells, shadows, used), ambient_basis(view, used, photograph)


@dataclass(frozen=True, eq=False)
class _End:
    """The end of a search: the best fit of a mask, and how many of the starts ended near it."""

    mask: Mask
    likelihood: Likelihood
    fit: MaskFit
    agreeing: int = 0
    starts: int = 0


def _behind_pictures(
    place: _Place,
    cells: tuple[int, int],
    photographs: Sequence[Photograph],
    pictures: Sequence[Array],
) -> _End:
    """Find the mask behind known pictures, (N, P) each: one descent from half opaque cells."""
    mask, Q = place.mask(cells, photographs[0])
    mask = replace(mask, shadows=mask.shadows.before(np.hstack(pictures)))
    likelihood = known_pictures(Q, [each.used for each in photographs], pictures)
    start = np.full(cells, 0.5), np.zeros(len(mask.terms))
    return _End(mask, likelihood, mask.descend(*start, likelihood))


def _behind_unknown_image(
    place: _Place,
    cells: tuple[int, int],
    coarse: Photograph,
    fine: Photograph,
    seed: int,
    report: Callable[[float], None],
) -> _End:
    """Find the mask behind an unknown image: few cells first, from random starts, then all."""
    images = SmoothImages.hats(place.hidden, place.hidden)

    def level(cells: tuple[int, int], photograph: Photograph) -> tuple[Mask, UnknownImage]:
        mask, Q = place.mask(cells, photograph)
        return mask, UnknownImage(photograph.used, Q, images)

    rows, columns = np.minimum(cells, place.plane.square_cells(FEW)).tolist()
    mask, image = level(cells, fine)
    fit, agreeing = search(level((rows, columns), coarse), (mask, image), seed, report)
    likelihood = image.at(mask.transport(np.zeros(cells), fit.gain), 0.0)
    return _End(mask, likelihood, fit, agreeing, STARTS)
