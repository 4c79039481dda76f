"""Find the silhouette of an unmeasured occluder, and the hidden image, from one photograph.

The visibility between a point of the wall and a patch of the monitor is linear in the opacities of
a flat mask's cells, so that the photograph is bilinear in mask and image: a blind deconvolution,
whose kernel is the mask. As Levin et al. (IEEE TPAMI 33, 2011) advise for that, the image is
integrated out while the mask is sought (`opacity_descent`), from many starts and coarse to fine,
and on from where a descent ends, patch by patch of the image (`mask_walk`); each cell is opaque or
open in the end (`binary_search`). That no patch shines negatively does most to tell the right mask
from others (`mask_evidence`).

What stays open: mask and image may be shifted against each other, as far as the image's border is
dark (hence the mask is preferred in the middle of its rectangle); and they may change places, each
turned by half a circle, if the image has one colour and is as bright as dark. Both would explain
the photograph alike; answers that do are told.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import replace
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any

import numpy as np
from numpy.typing import NDArray

from periscopy_sim.calibration.explanation.evidence import Explanation
from periscopy_sim.calibration.explanation.overdispersion import overdispersion
from periscopy_sim.calibration.explanation.resolution_level import (
    Rays,
    Resolution,
    ResolutionLevel,
)
from periscopy_sim.calibration.prior import Prior
from periscopy_sim.calibration.silhouette.cells.cell_size import (
    finest_photograph,
    fitted_cells,
    require_coarse,
)
from periscopy_sim.calibration.silhouette.cells.mask_plane import MaskPlane, mask_plane
from periscopy_sim.calibration.silhouette.replaced_shape import with_mesh
from periscopy_sim.calibration.silhouette.result import Silhouette, overlap
from periscopy_sim.calibration.silhouette.search.binary_search import binarized
from periscopy_sim.calibration.silhouette.search.mask_level import (
    NOTHING,
    MaskFit,
    MaskLevel,
    opaque,
    usual_opacity,
)
from periscopy_sim.calibration.silhouette.search.mask_moves import (
    patch_steps,
    resized,
    shifted,
    swapped,
)
from periscopy_sim.calibration.silhouette.search.mask_prior import improbability
from periscopy_sim.calibration.silhouette.search.mask_walk import walk
from periscopy_sim.calibration.silhouette.search.opacity_descent import (
    FROM_AFAR,
    NEARBY,
    ONWARD,
    Descended,
    descend,
    smooth_mask,
)
from periscopy_sim.errors import PhotographError, SceneError, VariantError
from periscopy_sim.model.observation import Backgrounds, named
from periscopy_sim.photograph import Photograph
from periscopy_sim.rendering.scene.load import load_scenario
from periscopy_sim.rendering.variant import install_llvm, is_vectorized
from periscopy_sim.scenario import Array
from periscopy_sim.shipped import find_scene

PATCHES = 22
"""Along the longer side of the hidden image that is looked for beside the mask."""

COARSE = Resolution(32, PATCHES, 1, Rays(16, 4), Rays(4, 4))
FINE = Resolution(63, PATCHES, 2, Rays(16, 4), Rays(4, 4))

HALVED = 8
"""Cells along a side from which on the search begins with cells of twice the size."""

STARTS = 12
"""Random masks that the search begins with."""

FINALISTS = 3
"""Of where they lead, looked at finely."""

HOPELESS = 100.0
"""Objective, over the overdispersion, by which a finalist exceeds the best one that is given up
before its cells are made opaque and open."""

SAME = 0.8
"""Overlap from which two masks are one answer."""

AGREEING = 0.6
"""Overlap of masks, one of them of cells twice as large, from which they are one."""

ALIKE = 20.0
"""Evidence, over the overdispersion, by which one answer must exceed another to exclude it."""

TOLD = 0.5
"""Part of the seen cells that the photograph must tell as numbers."""

PRIOR_PRECISION = 4.0
"""Of a cell's opacity, which is 0 or 1 as likely: its reciprocal variance."""

SHOWN = 50.0
"""Evidence that a mask must win over none for the photograph to show a shadow of it."""

LOOKS = 40
"""Of the walks, as a rule: how many there will be nobody knows, each is a part of what is left."""

PLACES = 2
"""Of a mask, patches apart, at which its cells are made opaque and open."""

UNSEEN = 1e-2
"""Part of the largest cell's shadow, below which a cell's is not seen."""


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
        (R, C) of the hidden image; of finer ones than 36 patches along a side a coarser one serves.
    shape
        The occluder's id. Its form does not matter, only the rectangle about it, see `MaskPlane`.
    cells
        (rows, columns) into which that is cut; by default 16 along its longer side, as square as
        they can be.
    parameters
        Values of the scene's ``<default>``s.
    backgrounds
        Photographs of the wall with the monitor off, of the photograph's size, or a mapping of
        their names to them: their light joins that from afar.
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

        def level(resolution: Resolution, parts: int) -> MaskLevel:
            rows, columns = (-(-count // parts) for count in cells)
            here = ResolutionLevel(
                empty, {}, (), Prior.none(0), y, off, mask, hidden, resolution, seed,
                lambda _: None,
            )  # fmt: skip
            return MaskLevel.of(here, plane, (rows, columns))

        halves = 1 + (max(cells) > HALVED)
        coarse = level(COARSE, halves)
        ends = ends_of_search(coarse, plane, seed, lambda part: report(0.4 * part))
        masks = different(ends)[:FINALISTS]
        fine = level(replace(FINE, photograph=finest_photograph(first, plane, cells)), 1)
        found = []
        for k, each in enumerate(masks):
            start = resized(each.opacities, cells) / (usual_opacity(each.opacities) or 1.0)
            found.append(descend(fine.evidence, np.minimum(start, 1.0), NEARBY))
            report(0.4 + 0.2 * (k + 1) / len(masks))
        answers = [
            replace(answer, agreeing=agreeing(answer.opaque, ends), starts=len(ends))
            for answer in _answers(fine, found, plane, shape, lambda part: report(0.6 + 0.4 * part))
        ]
        report(1.0)
    return replace(answers[0], others=tuple(answers[1:]))


def ends_of_search(
    level: MaskLevel,
    plane: MaskPlane,
    seed: int,
    report: Callable[[float], None] = lambda _: None,
) -> list[Descended]:
    """Return where random starts lead, and the best of them and its image with places changed."""
    random = np.random.default_rng(seed)
    found = []
    for k in range(STARTS):
        found.append(descend(level.evidence, smooth_mask(level.cells, random), FROM_AFAR))
        report((k + 1) / (STARTS + 1))
    best = min(found, key=lambda each: each.objective)
    other = swapped(level, plane, level.explain(best.opacities))
    if other.any():
        found.append(descend(level.evidence, other, NEARBY))
    return found


def agreeing(opaque_cells: NDArray[np.bool_], ends: list[Descended]) -> int:
    """Return how many of the search's ends are a mask, (rows, columns), as far as they are fine."""
    rows, columns = opaque_cells.shape
    fine = (resized(end.opaque.astype(float), (rows, columns)) > 0.5 for end in ends)
    return sum(overlap(mask, opaque_cells) >= AGREEING for mask in fine)


def different(found: list[Descended]) -> list[Descended]:
    """Return masks, the best first, no two the same but for a shift."""
    kept: list[Descended] = []
    for each in sorted(found, key=lambda each: each.objective):
        if all(overlap(each.opaque, other.opaque) < SAME for other in kept):
            kept.append(each)
    return kept


def _answers(
    level: MaskLevel,
    descended: list[Descended],
    plane: MaskPlane,
    name: str,
    report: Callable[[float], None],
) -> list[Silhouette]:
    """Return the best silhouette, and others that explain the photograph alike."""
    descended = different(descended)
    level = level.learned(level.explain(descended[0].opacities).explanation)
    limit = descended[0].objective + HOPELESS * level.level.overdispersion
    steps = patch_steps(plane, level.level.scenario(NOTHING), level.cells)
    done = 0.0

    def looked() -> None:
        nonlocal done
        done += (1 - done) / LOOKS
        report(done)

    ends = [
        descend(level.evidence, each.opacities, ONWARD)
        for each in descended
        if each.objective < limit
    ]
    onward = different([walk(level.evidence, end, steps, looked) for end in ends])
    found = [_finished(level, each, steps) for each in onward]
    # Errors are as strong as the best mask leaves them, not as the first did.
    best = min(found, key=lambda fit: fit.explanation.evidence)
    level = level.learned(best.explanation)
    found = sorted((level.explain(fit.opacities) for fit in found), key=lambda fit: fit.objective)
    most = found[0].explanation.evidence + ALIKE
    alike = found[:1]
    for fit in found[1:]:
        if fit.explanation.evidence < most and all(
            overlap(fit.opaque, each.opaque) < SAME for each in alike
        ):
            alike.append(fit)
    partly = min(
        (level.explain(each.opacities).explanation for each in onward), key=lambda e: e.evidence
    )
    return [_silhouette(level, fit, plane, name, partly) for fit in alike]


def _finished(level: MaskLevel, found: Descended, steps: Array) -> MaskFit:
    """Return the binary mask that a descent leads to.

    Opacities may imitate a mask that stands between cells, opaque and open ones cannot: so it is
    looked for where the image is a patch or two on, and at last by whole cells.
    """
    evidence, nothing = level.evidence, np.ones((len(level.evidence.smoothness), 3))
    α = evidence.best_ratio(found.opacities.ravel(), 0.0)

    def cost(mask: Array) -> float:
        cut = opaque(mask).astype(float)
        return evidence.at(cut.ravel(), α, 0.0, nothing)[0] / 2 + improbability(cut)[0]

    places = sorted(shifted(found.opacities, steps), key=cost)
    best = min((binarized(level, m) for m in places[:PLACES]), key=lambda fit: fit.objective)
    place = min(shifted(best.opacities, np.eye(2)), key=cost)
    if place is best.opacities:
        return best
    return min((best, binarized(level, place)), key=lambda fit: fit.objective)


def _silhouette(
    level: MaskLevel, fit: MaskFit, plane: MaskPlane, name: str, partly: Explanation
) -> Silhouette:
    """Return what is told of a binary mask, beside one whose cells may be partly open."""
    found, open_ = fit.explanation, level.explain(np.zeros(level.cells)).explanation
    if open_.evidence - found.evidence < SHOWN:
        raise PhotographError(
            f"the photograph shows no shadow of '{name}' in its rectangle; its silhouette cannot "
            "be found"
        )
    light = level.shadows.light_held_off
    seen = light > UNSEEN * light.max()
    _, H = level.linearized(fit)
    known = np.linalg.eigvalsh(H[np.ix_(seen, seen)])
    told = float((known / (known + PRIOR_PRECISION)).sum())
    if told < TOLD * seen.sum():
        rows, columns = (max(2, int(n * np.sqrt(told / seen.sum()))) for n in level.cells)
        raise SceneError(
            f"the photograph tells about {told:.0f} numbers of the {seen.sum()} cells of '{name}' "
            f"that it shows; ask for fewer, such as {rows}x{columns}"
        )
    whole = level.level.scale
    return Silhouette(
        name=name,
        plane=plane,
        opaque=fit.opaque,
        seen=seen.reshape(level.cells),
        told=told,
        image=found.images.reshape(*level.level.hidden_shape, 3),
        unexplained=_rms(found.noise) / whole,
        unexplained_open=_rms(open_.noise) / whole,
        unexplained_partly=_rms(partly.noise) / whole,
        between=2 * found.fit.freedom * float(np.log(found.noise / partly.noise).sum()) / told,
        residual=level.level.picture(found.residuals),
        overdispersion=overdispersion(found, level.level.used, level.level.seed),
        evidence=found.evidence,
    )


def _rms(values: Array) -> float:
    return float(np.sqrt(np.mean(values**2)))
