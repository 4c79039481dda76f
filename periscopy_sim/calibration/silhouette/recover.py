"""Find the silhouette of an unmeasured occluder: behind known pictures, or with the hidden image.

The light through a flat mask is linear in the opacities of its cells. Photographs of pictures that
the monitor is known to have shown make that a least-squares problem (`known`). Without such, the
image is unknown too (`blind`), and two questions stay open: mask and image may be shifted against
each other, as far as the image's border is dark; and they may change places, each turned by half a
circle, if the image has one colour and is as bright as dark.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from periscopy_sim.analytic.area_transport import area_transport
from periscopy_sim.analytic.point_light import point_light_backgrounds
from periscopy_sim.calibration.problem import LARGEST, Averaged, fitted
from periscopy_sim.calibration.silhouette.blind import STARTS, BlindPhotograph, search
from periscopy_sim.calibration.silhouette.known import KnownPictures
from periscopy_sim.calibration.silhouette.mask import MaskFit
from periscopy_sim.calibration.silhouette.plane import MaskPlane, require_coarse
from periscopy_sim.calibration.silhouette.result import Silhouette
from periscopy_sim.calibration.silhouette.shadows import CellShadows
from periscopy_sim.errors import ClosedFormError, PhotographError, SceneError
from periscopy_sim.model.ambient import background_basis, joined_basis
from periscopy_sim.model.observation import Backgrounds, named
from periscopy_sim.photograph import Photograph
from periscopy_sim.rendering.scene.load import load_scenario
from periscopy_sim.scenario import Array, Scenario
from periscopy_sim.shipped import find_scene
from periscopy_sim.storage.pictures import area_average

PATCHES = {False: 22, True: 36}
"""Along the longer side of the hidden image, by whether it is known."""

COARSE, FINE = 32, 63
"""Pixels along the longer side of the photograph: of first descents, and at least afterwards."""

HALVED = 8
"""Cells along a side from which on a blind search begins with cells of twice the size."""

SHOWN = 50.0
"""Evidence that a mask must win over none for the photograph to show a shadow of it."""

UNSEEN = 1e-2
"""Fraction of the largest cell's shadow below which a cell's is not seen."""


def recover_silhouette(
    photograph: NDArray[np.floating[Any]] | Sequence[NDArray[np.floating[Any]]],
    scene: str | Path,
    hidden: tuple[int, int],
    shape: str,
    cells: tuple[int, int] | None = None,
    *,
    shown: Sequence[NDArray[np.floating[Any]]] = (),
    parameters: Mapping[str, str | float] | None = None,
    backgrounds: Backgrounds | None = None,
    mask: NDArray[np.bool_] | None = None,
    seed: int = 0,
    progress: Callable[[float], None] | None = None,
) -> Silhouette:
    """Find the silhouette of a flat occluder that nobody measured.

    Parameters
    ----------
    photograph
        (rows, columns, 3), linear, of any unit; or one such for each picture shown.
    scene
        A Mitsuba XML file, or the name of a shipped scene.
    hidden
        (R, C) of the hidden image. Of an unknown one, the search uses at most 22 patches along a
        side, of a known one 36.
    shape
        The occluder's id. Its form does not matter, only the rectangle about it, see `MaskPlane`.
    cells
        (rows, columns) into which that is cut; by default 16 along its longer side, as square as
        they can be.
    shown
        (R, C, 3) pictures that the monitor showed, linear, one for each photograph. Two of them
        make the silhouette far more certain than any unknown image.
    parameters
        Values of the scene's ``<default>``s.
    backgrounds
        Photographs of the wall with the monitor off, of the photograph's size, or a mapping of
        their names to them: their light is projected out.
    mask
        (rows, columns) pixels to use; None for all.
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
        shadow into view, the cells are more than the photograph can tell, or the scene without the
        shape has no closed form (`analytic_transport`).
    PhotographError
        If photographs are not of the camera's size, show no shadow of the shape, or are not as many
        as pictures (without these: one).
    """
    from threadpoolctl import threadpool_limits

    given = {name: str(value) for name, value in (parameters or {}).items()}
    first = load_scenario(find_scene(scene), hidden, given)
    plane = MaskPlane.of(first, shape)
    cells = cells or plane.default_cells
    require_coarse(first, plane, cells)
    light = [
        np.asarray(each) for each in ([photograph] if np.ndim(photograph) == 3 else photograph)
    ]
    if len(light) != max(1, len(shown)):
        raise PhotographError(
            f"{len(light)} photographs of {len(shown)} shown pictures: give a photograph of each "
            "picture, or one photograph of an unknown one"
        )
    off = named(backgrounds)
    read = [
        Photograph.of(each, first.photograph_shape, mask=mask, monitor_off=off) for each in light
    ]
    patches = fitted(hidden, PATCHES[bool(shown)])
    needed = (
        max(first.photograph_shape)
        * plane.pixel(first)
        * max(count / side for count, side in zip(cells, plane.sides, strict=True))
    )
    pixels = int(np.clip(np.ceil(needed), FINE, LARGEST))
    report = progress or (lambda _: None)
    with threadpool_limits(1):
        fine = _View.of(first, plane, shape, cells, read, patches, pixels)
        if shown:
            pictures = [area_average(each, patches).reshape(-1, 3) for each in shown]
            known = KnownPictures.of(fine.shadows, cells, fine.background, fine.light, pictures)
            result = fine.silhouette(known.descend(), known.explain(np.zeros(cells)))
        else:
            halves = 1 + (max(cells) > HALVED)
            fewer = -(-cells[0] // halves), -(-cells[1] // halves)
            coarse = _View.of(first, plane, shape, fewer, read, patches, COARSE)
            few, many = (
                BlindPhotograph.of(
                    each.shadows, each.cells, each.background, each.light[0], patches
                )
                for each in (coarse, fine)
            )
            fit, agreeing = search(few, many, fine.steps, seed, report)
            result = fine.silhouette(fit, many.explain(np.zeros(cells)))
            result = replace(result, agreeing=agreeing, starts=STARTS)
    report(1.0)
    return result


@dataclass(frozen=True, eq=False)
class _View:
    """Photographs in M pixels, and a mask's cells as these see them."""

    name: str
    scenario: Scenario
    plane: MaskPlane
    cells: tuple[int, int]
    averaged: Averaged
    shadows: CellShadows
    background: Array  # (M, r) orthonormal basis of the ambient light

    @classmethod
    def of(
        cls,
        scenario: Scenario,
        plane: MaskPlane,
        name: str,
        cells: tuple[int, int],
        photographs: Sequence[Photograph],
        hidden: tuple[int, int],
        longest: int,
    ) -> _View:
        """Look at a scene with the occluder of a name replaced by a mask."""
        averaged = Averaged.of(photographs, longest)
        used = averaged.pixels
        finer = -(-LARGEST // max(used.shape))
        views = [
            load_scenario(
                scenario.path,
                hidden,
                scenario.parameters,
                photograph=(times * used.shape[0], times * used.shape[1]),
            )
            for times in (1, finer)
        ]
        view, fine = (
            replace(each, occluders=tuple(o for o in each.occluders if o.name != name))
            for each in views
        )
        try:
            A = area_transport(fine, finer)[used.ravel()]
        except ClosedFormError as error:
            raise SceneError(str(error)) from None
        shadows = CellShadows.of(A, view, plane, cells, used)
        if not shadows.light.any():
            raise SceneError(
                f"scene '{scenario.path}': occluder '{name}' casts no shadow of the monitor into "
                "what the camera sees of the wall, wherever in its rectangle it is opaque"
            )
        Q = background_basis(point_light_backgrounds(view)[used.ravel()])
        Q = joined_basis(Q, np.hstack([Q[:, :0], *(each[used] for each in averaged.monitor_off)]))
        return cls(name, view, plane, cells, averaged, shadows, Q)

    @property
    def light(self) -> list[Array]:
        """(M, 3) of each photograph."""
        return [each[self.averaged.pixels] for each in self.averaged.light]

    @property
    def steps(self) -> Array:
        """(2, 2) cells down and across that a mask moves as the image does by a patch.

        The first is that of a patch up, the second that of one across. By so much a mask and its
        image may be shifted against each other, and the photograph changes least.
        """
        scene = self.scenario
        edges = np.stack([scene.patch_up.mean(axis=0), scene.patch_across.mean(axis=0)])
        rows, _ = self.plane.rows_of_projection()
        by_patch = self.plane.fraction(scene) * edges @ rows[[1, 0]].T
        return np.asarray(by_patch * np.array(self.cells))

    def silhouette(self, fit: MaskFit, without: MaskFit) -> Silhouette:
        """Return a result; a PhotographError says that it is no better than without a mask."""
        if without.evidence - fit.evidence < SHOWN:
            raise PhotographError(
                f"the photograph shows no shadow of '{self.name}' in its rectangle; its silhouette "
                "cannot be found"
            )
        light, used = self.shadows.light, self.averaged.pixels
        scale = float(np.sqrt(np.mean(np.square(self.light))))
        picture = np.zeros((*used.shape, 3))
        picture[used] = fit.residual[0] / scale
        return Silhouette(
            name=self.name,
            plane=self.plane,
            opacities=fit.opacities,
            seen=(light > UNSEEN * light.max()).reshape(self.cells),
            image=fit.image.reshape(*self.scenario.hidden_shape, 3),
            unexplained=float(np.sqrt(np.mean(fit.residual**2))) / scale,
            unexplained_open=float(np.sqrt(np.mean(without.residual**2))) / scale,
            residual=picture,
            evidence=fit.evidence,
        )
