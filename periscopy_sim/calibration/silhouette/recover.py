"""Find the silhouette of an unmeasured occluder, and the hidden image, from one photograph.

The visibility between a point of the wall and a patch of the monitor is linear in the opacities of
a flat mask's cells, so that the photograph is bilinear in mask and image: a blind deconvolution,
whose kernel is the mask. As Levin et al. (IEEE TPAMI 33, 2011) advise for that, the image is
integrated out while the mask is sought, from many smooth random starts, coarse to fine, and on from
where a descent ends, patch by patch of the image (`walk`); each cell is opaque or open in the end
(`binarized`).

What stays open: mask and image may be shifted against each other, as far as the image's border is
dark; and they may change places, each turned by half a circle, if the image has one colour and is
as bright as dark. `Silhouette.others` are answers that explain the photograph as well.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass, replace
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any

import numpy as np
from numpy.typing import NDArray

from periscopy_sim.calibration.level import Averaged
from periscopy_sim.calibration.scene_matrices import SceneMatrices
from periscopy_sim.calibration.silhouette.evidence import (
    MaskEvidence,
    MaskFit,
    Stages,
    descend,
    opaque,
    usual_opacity,
)
from periscopy_sim.calibration.silhouette.moves import (
    ONWARD,
    binarized,
    resized,
    shifted,
    smooth_mask,
    walk,
)
from periscopy_sim.calibration.silhouette.plane import (
    MaskPlane,
    finest_photograph,
    fitted_cells,
    mask_plane,
    require_coarse,
)
from periscopy_sim.calibration.silhouette.result import Silhouette, overlap
from periscopy_sim.calibration.silhouette.scene import with_mesh
from periscopy_sim.calibration.silhouette.shadows import CellShadows
from periscopy_sim.calibration.whitening import WhiteNoise
from periscopy_sim.errors import PhotographError, SceneError, VariantError
from periscopy_sim.model.ambient import background_basis, joined_basis
from periscopy_sim.model.observation import Backgrounds, named
from periscopy_sim.photograph import Photograph
from periscopy_sim.rendering.scene.load import load_scenario
from periscopy_sim.rendering.variant import install_llvm, is_vectorized
from periscopy_sim.scenario import Array, Scenario
from periscopy_sim.shipped import find_scene

PATCHES = 22
"""Along the longer side of the hidden image that is looked for beside the mask."""

COARSE = 32
"""Pixels along the longer side of the photograph, for the first descents."""

HALVED = 8
"""Cells along a side from which on the search begins with cells of twice the size."""

STARTS, FINALISTS = 12, 3
"""Random masks that the search begins with; of where they lead, looked at finely."""

PLACES = 2
"""Of a mask, patches apart, at which its cells are made opaque and open."""

FROM_AFAR: Stages = ((1e-1, 20), (1e-2, 20), (0.0, 30))
NEARBY: Stages = ((1e-3, 20), (0.0, 30))
HOPELESS = 100.0
"""Objective, over κ, by which a finalist exceeds the best one that is given up."""

SAME, AGREEING = 0.8, 0.6
"""Overlaps from which masks are one answer: of the same cells, and one of cells twice as large."""

ALIKE = 20.0
"""Evidence, over κ, by which one answer must exceed another to exclude it."""

TOLD, PRIOR_PRECISION = 0.5, 4.0
"""Fraction of the seen cells that the photograph must tell as numbers; the reciprocal variance of
an opacity that is 0 or 1 as likely."""

SHOWN = 50.0
"""Evidence that a mask must win over none for the photograph to show a shadow of it."""

UNSEEN = 1e-2
"""Fraction of the largest cell's shadow below which a cell's is not seen."""


def recover_silhouette(
    photograph: NDArray[np.floating[Any]],
    scene: str | Path,
    hidden: tuple[int, int],
    shape: str,
    cells: tuple[int, int] | None = None,
    *,
    parameters: Mapping[str, str | float] | None = None,
    backgrounds: Backgrounds | None = None,
    mask: NDArray[np.bool_] | None = None,
    seed: int = 0,
    progress: Callable[[float], None] | None = None,
) -> Silhouette:
    """Find the silhouette of a flat occluder that nobody measured, and the hidden image.

    Parameters
    ----------
    photograph
        (rows, columns, 3), linear, of any unit.
    scene
        A Mitsuba XML file, or the name of a shipped scene.
    hidden
        (R, C) of the hidden image; the search uses at most 22 patches along a side.
    shape
        The occluder's id. Its form does not matter, only the rectangle about it, see `MaskPlane`.
    cells
        (rows, columns) into which that is cut; by default 16 along its longer side, as square as
        they can be.
    parameters
        Values of the scene's ``<default>``s.
    backgrounds
        Photographs of the wall with the monitor off, of the photograph's size, or a mapping of
        their names to them: their light is projected out.
    mask
        (rows, columns) pixels to use; None for all.
    seed
        Of the starts and the rays.
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
        shadow into view, or the cells are more than the photograph can tell.
    PhotographError
        If the photograph is not of the camera's size, or shows no shadow of the shape.
    VariantError
        In scalar variants, which would take days.
    """
    from threadpoolctl import threadpool_limits

    path = find_scene(scene)
    given = {name: str(value) for name, value in (parameters or {}).items()}
    first = load_scenario(path, hidden, given)
    plane = mask_plane(first, shape)
    cells = cells or fitted_cells(plane)
    require_coarse(first, plane, cells)
    if not is_vectorized():
        raise VariantError("calibration renders transport matrices; " + install_llvm())
    light = Photograph.of(
        photograph, first.photograph_shape, mask=mask, monitor_off=named(backgrounds or [])
    )
    y, off = light.values, list(light.monitor_off.values())
    report = progress or (lambda _: None)
    with threadpool_limits(1), TemporaryDirectory() as folder:
        empty = Path(folder) / path.name
        # Given values as its defaults: what the shape alone uses, Mitsuba would not take.
        empty.write_text(with_mesh(path, shape, None, given, empty.parent), encoding="utf-8")

        def level(pixels: int, parts: int) -> MaskLevel:
            averaged = Averaged.of(y, off, mask, pixels)
            size = (-(-cells[0] // parts), -(-cells[1] // parts))
            return MaskLevel.of(
                averaged, empty, averaged.hidden_shape(hidden, PATCHES), plane, size
            )

        coarse = level(COARSE, 1 + (max(cells) > HALVED))
        ends = coarse.ends(seed, lambda part: report(0.4 * part))
        fine = level(finest_photograph(first, plane, cells), 1)
        found = []
        for k, end in enumerate(different(ends)[:FINALISTS]):
            start = resized(end.opacities, cells) / (usual_opacity(end.opacities) or 1.0)
            found.append(descend(fine.evidence, np.minimum(start, 1.0), NEARBY))
            report(0.4 + 0.2 * (k + 1) / FINALISTS)
        answers = fine.answers(different(found), shape, lambda part: report(0.6 + 0.4 * part))
        answers = [
            replace(answer, agreeing=agreeing(answer.opaque, ends), starts=len(ends))
            for answer in answers
        ]
        report(1.0)
    return replace(answers[0], others=tuple(answers[1:]))


@dataclass(frozen=True, eq=False)
class MaskLevel:
    """A photograph at one resolution, explained by a mask of (rows, columns) of cells in a plane.

    The scenario is without the mask.
    """

    averaged: Averaged
    evidence: MaskEvidence
    scenario: Scenario
    plane: MaskPlane
    cells: tuple[int, int]

    @classmethod
    def of(
        cls,
        averaged: Averaged,
        empty: Path,
        hidden: tuple[int, int],
        plane: MaskPlane,
        cells: tuple[int, int],
    ) -> MaskLevel:
        """Return that of a scene's file without the mask, and (R, C) of the hidden image."""
        rows, columns = averaged.used.shape
        matrices = SceneMatrices(empty, {}, (), np.empty(0), (rows, columns), hidden, hats=False)
        used, nothing = averaged.used.ravel(), np.empty(0)
        scenario = load_scenario(empty, hidden, {}, photograph=(rows, columns))
        A = matrices.matrix(nothing)[used]
        B = matrices.point_lights(nothing)[used]
        basis = joined_basis(background_basis(B), np.hstack([B[:, :0], *averaged.off]))
        shadows = CellShadows.of(A, scenario, plane, cells, averaged.used)
        return cls(
            averaged, MaskEvidence.of(shadows, averaged, basis, hidden), scenario, plane, cells
        )

    def ends(self, seed: int, report: Callable[[float], None]) -> list[MaskFit]:
        """Return where random starts lead, and the best of them and its image swapped."""
        random = np.random.default_rng(seed)
        found = []
        for k in range(STARTS):
            found.append(descend(self.evidence, smooth_mask(self.cells, random), FROM_AFAR))
            report((k + 1) / (STARTS + 1))
        other = self.swapped(min(found, key=lambda fit: fit.objective))
        if other.any():
            found.append(descend(self.evidence, other, NEARBY))
        return found

    def swapped(self, fit: MaskFit) -> Array:
        """Return the mask that is the image of a fit, turned by half a circle, (rows, columns).

        From x, mask m and image f are seen as ∫ m(x + t (q − x)) f(q) dq, t the fraction of the way
        at which the mask stands. f(−p/t) in the place of the mask, m(−t q) in that of the image
        give the same for all x but for a shift.
        """
        from scipy.spatial import KDTree

        rows, columns = self.cells
        down, across = np.indices(self.cells) + 0.5
        cells = self.plane.at(np.stack([across / columns, down / rows], axis=-1)).reshape(-1, 3)
        monitor = self.scenario.patch_centers.mean(axis=0)
        middle = self.plane.at(np.array([0.5, 0.5]))
        places = monitor - (cells - middle) / self.plane.part(self.scenario)
        distance, nearest = KDTree(self.scenario.patch_centers).query(places)
        size = np.sqrt(self.scenario.patch_areas.max())
        grey = np.where(distance < size, fit.images.mean(axis=1)[nearest], 0.0)
        return np.asarray(grey / max(grey.max(), 1e-300)).reshape(self.cells)

    @property
    def steps(self) -> Array:
        """(2, 2) cells down and across that a mask moves as the image does by a patch.

        The first is that of a patch up, the second that of one across. By so much a mask and its
        image may be shifted against each other, and the photograph changes least.
        """
        scenario = self.scenario
        edges = np.stack([scenario.patch_up.mean(axis=0), scenario.patch_across.mean(axis=0)])
        rows, _ = self.plane.rows_of_projection()
        by_patch = self.plane.part(scenario) * edges @ rows[[1, 0]].T
        return np.asarray(by_patch * np.array(self.cells))

    def overdispersion(self, fit: MaskFit) -> float:
        """Return how much stronger a residual is than white noise at some scale, at least 1."""
        noise = WhiteNoise.of(fit, self.averaged.used, 0)
        return max(1.0, noise.whitening(fit).discrepancy)

    def answers(
        self, found: list[MaskFit], name: str, report: Callable[[float], None]
    ) -> list[Silhouette]:
        """Return the best silhouette, and others that explain the photograph alike."""
        κ = self.overdispersion(found[0])
        evidence = self.evidence.tempered(κ)
        limit = found[0].objective + HOPELESS * κ
        walked, finished = [], []
        hopeful = [fit for fit in found if fit.objective < limit]
        for k, fit in enumerate(hopeful):
            walked.append(walk(evidence, descend(evidence, fit.opacities, ONWARD), self.steps))
            report((k + 0.7) / len(hopeful))
        for fit in different(walked):
            finished.append(self._finished(evidence, fit))
        # Errors are as strong as the best mask leaves them, not as the first did.
        κ = self.overdispersion(min(finished, key=lambda fit: fit.evidence))
        evidence = self.evidence.tempered(κ)
        finished = [evidence.explain(fit.opacities) for fit in finished]
        most = min(fit.evidence for fit in finished) + ALIKE
        alike = [fit for fit in different(finished) if fit.evidence < most]
        partly = min((evidence.explain(fit.opacities) for fit in walked), key=lambda f: f.evidence)
        return [self._silhouette(evidence, fit, name, partly) for fit in alike]

    def _finished(self, evidence: MaskEvidence, fit: MaskFit) -> MaskFit:
        """Return the binary mask that a descent leads to.

        Opacities may imitate a mask that stands between cells, opaque and open ones cannot: so it
        is looked for where the image is a patch or two on, and at last by whole cells.
        """

        def cost(mask: Array) -> float:
            return evidence.explain(opaque(mask).astype(float)).objective

        places = sorted(shifted(fit.opacities, self.steps), key=cost)
        best = min((binarized(evidence, m) for m in places[:PLACES]), key=lambda f: f.objective)
        place = min(shifted(best.opacities, np.eye(2)), key=cost)
        if place is best.opacities:
            return best
        return min((best, binarized(evidence, place)), key=lambda f: f.objective)

    def _silhouette(
        self, evidence: MaskEvidence, fit: MaskFit, name: str, partly: MaskFit
    ) -> Silhouette:
        """Return what is known of a binary mask, beside one whose cells may be partly open."""
        nothing = evidence.explain(np.zeros(self.cells))
        if nothing.evidence - fit.evidence < SHOWN:
            raise PhotographError(
                f"the photograph shows no shadow of '{name}' in its rectangle; its silhouette "
                "cannot be found"
            )
        light = evidence.shadows.light_held_off
        seen = light > UNSEEN * light.max()
        _, H = fit.linearized()
        known = np.linalg.eigvalsh(H[np.ix_(seen, seen)])
        told = float((known / (known + PRIOR_PRECISION)).sum())
        if told < TOLD * seen.sum():
            rows, columns = (max(2, int(n * np.sqrt(told / seen.sum()))) for n in self.cells)
            raise SceneError(
                f"the photograph tells about {told:.0f} numbers of the {seen.sum()} cells of "
                f"'{name}' that it shows; ask for fewer, such as --cells {rows}x{columns}"
            )
        whole = self.averaged.scale
        unexplained = (float(np.sqrt(np.mean(f.noise**2))) / whole for f in (fit, nothing, partly))
        of_mask, of_nothing, of_partly = unexplained
        return Silhouette(
            name=name,
            plane=self.plane,
            opaque=fit.opaque,
            seen=seen.reshape(self.cells),
            told=told,
            image=fit.images.reshape(*self.scenario.hidden_shape, 3),
            unexplained=of_mask,
            unexplained_open=of_nothing,
            unexplained_partly=of_partly,
            between=2 * evidence.freedom * float(np.log(fit.noise / partly.noise).sum()) / told,
            residual=self.averaged.picture(fit.residual / whole),
            overdispersion=self.overdispersion(fit),
            evidence=fit.evidence,
        )


def agreeing(opaque_cells: NDArray[np.bool_], ends: list[MaskFit]) -> int:
    """Return how many of the search's ends are a mask, (rows, columns), as far as they are fine."""
    rows, columns = opaque_cells.shape
    fine = (resized(end.opaque.astype(float), (rows, columns)) > 0.5 for end in ends)
    return sum(overlap(mask, opaque_cells) >= AGREEING for mask in fine)


def different(found: list[MaskFit]) -> list[MaskFit]:
    """Return masks, the best first, no two the same but for a shift."""
    kept: list[MaskFit] = []
    for each in sorted(found, key=lambda each: each.objective):
        if all(overlap(each.opaque, other.opaque) < SAME for other in kept):
            kept.append(each)
    return kept
