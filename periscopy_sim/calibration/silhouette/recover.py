"""Find the silhouette of an unmeasured occluder: behind known pictures, or with the hidden image.

The light through a flat mask is linear in the opacities of its cells. Photographs of pictures that
the monitor is known to have shown leave one descent to do (`mask`). Without such, the image is
unknown too (`unknown`), and two questions stay open: mask and image may be shifted against each
other, as far as the image's border is dark; and they may change places, each turned by half a
circle, if the image has one colour and is as bright as dark.
"""

from collections.abc import Callable, Mapping, Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray
from threadpoolctl import threadpool_limits

from periscopy_sim.analytic.area_transport import area_transport
from periscopy_sim.calibration.evidence import SmoothImages
from periscopy_sim.calibration.moving_scene import fitted
from periscopy_sim.calibration.problem import (
    COARSE_HATS,
    LARGEST,
    MOST_PATCHES,
    ambient_basis,
    finest_view,
)
from periscopy_sim.calibration.silhouette.mask import Likelihood, Mask, known_pictures
from periscopy_sim.calibration.silhouette.plane import MaskPlane
from periscopy_sim.calibration.silhouette.result import Silhouette
from periscopy_sim.calibration.silhouette.shadows import CellShadows
from periscopy_sim.calibration.silhouette.unknown import STARTS, UnknownImage, search
from periscopy_sim.calibration.trust import is_significant
from periscopy_sim.errors import PhotographError, SceneError
from periscopy_sim.hidden import Hidden
from periscopy_sim.numerics import Array, Image
from periscopy_sim.photograph import Photograph, of_one_wall
from periscopy_sim.rendering.scene.load import load_scenario
from periscopy_sim.scenario import Scenario
from periscopy_sim.scene import Scene
from periscopy_sim.storage.pictures import area_average, averaged_photograph
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
    hidden: tuple[int, int],
    shape: str,
    cells: tuple[int, int] | None = None,
    *,
    shown: Sequence[NDArray[np.floating[Any]]] = (),
    parameters: Mapping[str, str | float] | None = None,
    seed: int = 0,
    progress: Callable[[float], None] | None = None,
) -> Silhouette:
    """Find the silhouette of a flat occluder that nobody measured.

    Parameters
    ----------
    photograph
        A `Photograph`, or (rows, columns, C), linear, of any unit; or one such for each picture
        shown. The pixels used are those that all masks leave; the light of all photographs with the
        monitor off is projected out. Photographs with a colour matrix are unmixed first.
    scene
        A Mitsuba XML file, the name of a shipped scene, or a scene that was loaded.
    hidden
        (R, C) of the hidden image. Of an unknown one, the search uses at most 24 patches along a
        side, of a known one 36.
    shape
        The occluder's id. Its form does not matter, only the rectangle about it, see `MaskPlane`.
    cells
        (rows, columns) into which that is cut; by default 16 along its longer side, as square as
        they can be.
    shown
        (R, C, P) pictures that the monitor showed, linear, one for each photograph. Two of them
        make the silhouette far more certain than any unknown image.
    parameters
        Values of the scene's ``<default>``s.
    seed
        Of the random masks from which a search for an unknown image starts.
    progress
        Called with the fraction done, 1 at last.

    Returns
    -------
    Silhouette
        See there; look at `Silhouette.doubts` first.

    Raises
    ------
    SceneError
        If the shape is no occluder, its rectangle is not between monitor and wall or casts no
        shadow into view, the cells are more than the photograph resolves, or the scene without the
        shape has no closed form (`analytic_transport`).
    PhotographError
        If photographs are not of the camera's size, show no shadow of the shape, or are not as many
        as pictures (without these: one).
    """
    report = progress or (lambda _: None)
    first = load_scenario(scene, hidden, parameters)
    plane = MaskPlane.of(first, shape)
    cells = cells or plane.square_cells()
    needed = max(first.photograph_shape) / plane.pixels_a_cell(first, cells)
    size = first.photograph_shape
    read = [each.unmixed() for each in of_one_wall(photograph, size)]
    if len(read) != max(1, len(shown)):
        raise PhotographError(
            f"{len(read)} photographs of {len(shown)} shown pictures: give a photograph of each "
            "picture, or one photograph of an unknown one"
        )
    longest = int(np.clip(np.ceil(needed), LARGEST // 2, LARGEST))
    averaged = [averaged_photograph(each, fitted(size, longest)) for each in read]
    used, agreeing, starts = averaged[0].pixels, 0, 0
    patches = fitted(hidden, MOST_PATCHES if shown else COARSE_HATS)
    ys = [each.used for each in averaged]
    with threadpool_limits(1):
        masked, Q = _masked(first, plane, shape, cells, averaged[0], patches)
        if shown:
            pictures = [area_average(each, patches) for each in shown]
            likelihood: Likelihood = known_pictures(Q, ys, pictures)
            colours = np.hstack([picture.reshape(-1, picture.shape[2]) for picture in pictures])
            masked = replace(masked, shadows=masked.shadows.before(colours))
            fit = masked.descend(np.full(cells, 0.5), np.zeros(len(masked.terms)), likelihood)
        else:
            hats = Hidden.of_scene(first.scene, patches)
            images = SmoothImages.hats(hats, hats)
            coarse = averaged_photograph(read[0], fitted(size, LARGEST // 4))
            rows, columns = np.minimum(cells, plane.square_cells(FEW)).tolist()
            few, Q_few = _masked(first, plane, shape, (rows, columns), coarse, patches)
            unknown = UnknownImage(ys[0], Q, images)
            seen = UnknownImage(coarse.used, Q_few, images)
            fit, agreeing = search((few, seen), (masked, unknown), seed, report)
            starts = STARTS
            likelihood = unknown.at(masked.transport(np.zeros(cells), fit.gain), 0.0)
        without = masked.fit(np.zeros(cells), fit.gain, likelihood)
    if not is_significant(2 * (without.objective - fit.objective), fit.opacities.size):
        raise PhotographError(
            f"the photograph shows no shadow of '{shape}' in its rectangle; its silhouette cannot "
            "be found"
        )
    image = colours @ fit.explained.image if shown else fit.explained.image
    report(1.0)
    scale = float(np.sqrt(np.mean(np.square(ys))))
    residual = np.zeros((*used.shape, fit.explained.residual.shape[2]))
    residual[used] = fit.explained.residual[0] / scale
    unexplained, unexplained_open = (
        float(np.sqrt(np.mean(each.explained.residual**2))) / scale for each in (fit, without)
    )
    shadow = masked.shadows.light
    return Silhouette(
        name=shape,
        plane=plane,
        opacities=fit.opacities,
        seen=(shadow > UNSEEN * shadow.max()).reshape(cells),
        image=image.reshape(*patches, -1),
        unexplained=unexplained,
        unexplained_open=unexplained_open,
        residual=residual,
        evidence=fit.explained.evidence,
        agreeing=agreeing,
        starts=starts,
    )


def _masked(
    scenario: Scenario,
    plane: MaskPlane,
    name: str,
    cells: tuple[int, int],
    photograph: Photograph,
    hidden: tuple[int, int],
) -> tuple[Mask, Array]:
    """Return a mask in the place of an occluder, and a basis of range(B), (M, r), orthonormal."""
    used, scene = photograph.pixels, scenario.scene
    view, patches = View.of(scene, photograph.shape), Hidden.of_scene(scene, hidden)
    fine = finest_view(scene, photograph.shape).of_pixels(used)
    without = replace(fine, scene=scene.without(name))
    A = area_transport(Scenario(without, patches))
    shadows = CellShadows.of(A, Scenario(view, patches), plane, cells, used)
    if not shadows.light.any():
        raise SceneError(
            f"scene '{scenario.path}': occluder '{name}' casts no shadow of the monitor into what "
            "the camera sees of the wall, wherever in its rectangle it is opaque"
        )
    return Mask.of(cells, shadows, used), ambient_basis(view, used, photograph)
