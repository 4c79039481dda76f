"""Find the silhouette of an unmeasured occluder: behind known pictures, or with the hidden image.

The light through a flat mask is linear in the opacities of its cells. Photographs of pictures that
the monitor is known to have shown leave one descent to do (`masks`). Without such, the image is
unknown too, and two questions stay open: mask and image may be shifted against each
other, as far as the image's border is dark; and they may change places, each turned by half a
circle, if the image has one colour and is as bright as dark.

Behind an unknown image, descents start from random masks.

Where the scene declares that the depth of the plane errs, the search begins at several depths and
refines the best one, see `mask_depth`.

    E(A) = Σ_c F log(S_c + τ ‖y⊥_c‖²) + 3 log |A⊥ᵀA⊥ + α K| / |α K|
    S_c = min ‖y⊥_c − A⊥ f‖² + α fᵀ K f  over f ≥ 0

The photograph is bilinear in mask and image: a blind deconvolution, whose kernel is the mask. As
Levin et al. (IEEE TPAMI 33, 2011) advise for that, the image is integrated out while the mask is
estimated. The constraint f ≥ 0 rules out most wrong masks: without it a wrong mask
explains a photograph nearly as well. α is fixed while opacities move. The allowance τ is a fraction
of the photograph that need not be explained yet: the larger, the smoother is E.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import asdict, dataclass, field, replace
from functools import cached_property, partial
from pathlib import Path
from typing import Any, Self

import numpy as np
from numpy.typing import NDArray
from scipy import linalg
from scipy.ndimage import gaussian_filter
from scipy.optimize import nnls
from scipy.special import ndtr
from threadpoolctl import threadpool_limits

from periscopy_sim.analytic.area_transport import area_transport, points_across
from periscopy_sim.calibration import calibrated_scene, moving_scene, prior, problem, trust
from periscopy_sim.calibration.evidence import ROUNDING, Matrix, SmoothImages
from periscopy_sim.calibration.mask_depth import MARGINS, Depth
from periscopy_sim.calibration.masks import (
    Cells,
    CellShadows,
    Explained,
    Likelihood,
    Mask,
    MaskFit,
    MaskPlane,
    known_pictures,
    opaque,
    usual_opacity,
)
from periscopy_sim.calibration.prior import SceneCovariance
from periscopy_sim.calibration.result import Parameter
from periscopy_sim.errors import PhotographError, SceneError
from periscopy_sim.hidden import Hidden, Sizes
from periscopy_sim.numerics import Array, Image
from periscopy_sim.photograph import Photograph, of_one_wall
from periscopy_sim.rendering.load import load_geometry
from periscopy_sim.rendering.nodes import SceneNodes
from periscopy_sim.rendering.scene_files import TriangleMesh, literal, write_ply
from periscopy_sim.scene import CALIBRATED, CAMERA, RULER_ERROR, Scene, SceneDocument
from periscopy_sim.storage.pictures import averaged_photograph
from periscopy_sim.view import Geometry, View

UNDECIDED, DECIDED = (0.2, 0.8), 0.9
"""Opacities, over the usual one, between which a cell is neither opaque nor open, and the fraction
of cells seen that must be one of both."""


@dataclass(frozen=True, eq=False)
class Silhouette:
    """A flat mask that explains photographs, estimated with the hidden image or by known pictures.

    Beside an unknown image, both may be shifted against each other.

    Attributes
    ----------
    name
        Id of the shape whose place it takes.
    plane
        The rectangle of its cells.
    depth
        The plane's distance from the monitor over the measured one.
    opacities
        (rows, columns) of cells, 0 to 1, top left first as one sees it who faces the wall.
    seen
        (rows, columns) whether the photograph shows the cell's shadow; else its neighbours decide.
    image
        (R, C, 3) the hidden image, linear, of several surfaces a mapping by id: the one estimated
        with the mask, or the first one shown.
    unexplained, unexplained_open
        Residual of the photographs with the mask and without one, over their root mean square.
    residual
        (rows, columns, 3) of the first photograph, likewise.
    evidence
        Twice the negative logarithm of the photograph's likelihood: less is better.
    agreeing, starts
        How many of the search's starts ended at this mask; of how many. Both are 0 where pictures
        are known.
    """

    name: str
    plane: MaskPlane
    depth: Depth
    opacities: Array
    seen: Cells
    image: Any = field(repr=False)
    unexplained: float
    unexplained_open: float
    residual: Array = field(repr=False)
    evidence: float
    agreeing: int = 0
    starts: int = 0

    @property
    def opaque(self) -> Cells:
        """(rows, columns) whether cells are opaque rather than not."""
        return opaque(self.opacities)

    @property
    def parameters(self) -> tuple[Parameter, ...]:
        """The scene's numbers that the plane's depth changes."""
        trusted = not self.doubts
        return tuple(replace(each, trusted=trusted) for each in self.depth.parameters)

    @property
    def decided(self) -> float:
        """Fraction of the cells seen that are clearly opaque or clearly open."""
        of_usual = self.opacities / max(usual_opacity(self.opacities), 1e-300)
        low, high = UNDECIDED
        return float(np.mean(((of_usual < low) | (of_usual > high))[self.seen]))

    @property
    def doubts(self) -> tuple[str, ...]:
        """Why it is not to be believed; empty if nothing speaks against it."""
        doubts = []
        if self.unexplained > self.unexplained_open / 2:
            doubts.append(
                "the mask explains less than half of what the photograph shows without it"
            )
        if self.decided < DECIDED:
            doubts.append(
                f"{100 * (1 - self.decided):.0f} % of the cells are neither opaque nor open"
            )
        if self.starts and self.agreeing < 2:
            doubts.append(
                f"only one of the search's {self.starts} starts ended near it: there may be a "
                "better one"
            )
        return tuple(doubts)

    def record(self) -> dict[str, Any]:
        """Return the silhouette as its JSON file has it."""
        return {
            "shape": self.name,
            "trusted": not self.doubts,
            "doubts": self.doubts,
            "rectangle": asdict(self.plane),
            "parameters": {each.name: each.record() for each in self.parameters},
            "opaque": ["".join("#" if cell else "." for cell in row) for row in self.opaque],
            "cells_seen": int(self.seen.sum()),
            "cells_decided": self.decided,
            "starts_agreeing": self.agreeing,
            "opacities": self.opacities,
            "unexplained_open": self.unexplained_open,
            "unexplained": self.unexplained,
            "starts": self.starts,
            "evidence": self.evidence,
        }


_OWN = ("string", "float", "integer", "boolean", "point", "vector", "rgb", "spectrum")
"""Tags that are a shape's numbers; its place and its material are others."""


def write_masked_scene(
    scene: SceneDocument,
    solution: Silhouette,
    copy: Path,
    mesh: Path,
    mesh_name: str,
    remark: str = "",
) -> None:
    """Write a scene with the values given and a flat mesh in the place of a shape.

    The mesh is written in the shape's own coordinates, so that the parameters that move the shape
    move it, and has the shape's id and material. In the scene its file is called `mesh_name`, which
    it has once both are in their place. Numbers that move the shape alone have no error any more: a
    number ``NAME_scale`` has it, which moves the mask to or from the monitor and scales its cells.
    If the silhouette is not trusted, the scene carries that, see `SceneCovariance`. For the rest
    see `with_defaults`.

    Raises
    ------
    SceneError
        As `with_defaults`, or if the shape's tag is not in the file itself.
    """
    name, depth = solution.name, solution.depth
    values = {each.name: f"{each.value:.9g}" for each in depth.parameters}
    places = SceneNodes(scene.path, {**scene.given, **values}).layout().places
    to_world, whole = places[name], cell_mesh(solution.plane, solution.opaque)
    vertices = (whole.vertices - to_world[:3, 3]) @ np.linalg.pinv(to_world[:3, :3]).T
    write_ply(mesh, TriangleMesh(vertices, whole.faces))
    values |= {f"{each}{RULER_ERROR}": "0" for each in depth.values}
    known, scale = prior.scene_covariance(scene) or SceneCovariance.none(), f"{name}_scale"
    is_new = depth.error > 0 and scale not in scene.values
    if is_new:
        values[scale] = "1"
        known = known.joined(scale, 1.0, depth.error / depth.scale, 1.0)
    if known.names or solution.doubts:
        known = replace(known, trusted=known.trusted and not solution.doubts)
        values[CALIBRATED] = known.text()
    document = calibrated_scene.with_defaults(scene, values, copy.parent, remark)
    shapes = document.getElementsByTagName("shape")
    shape = next((each for each in shapes if each.getAttribute("id") == name), None)
    if shape is None:
        raise SceneError(
            f"scene '{scene.path}': the shape '{name}' is not written in this file itself; copy it "
            "there from the file that is included"
        )
    shape.setAttribute("type", "ply")
    for child in list(shape.childNodes):
        if child.nodeName in _OWN:
            shape.removeChild(child)
    if is_new:
        calibrated_scene.scale_about(document, shape, depth.monitor.tolist(), f"${scale}")
    file = calibrated_scene.element(document, "string", name="filename", value=literal(mesh_name))
    normals = calibrated_scene.element(document, "boolean", name="face_normals", value="true")
    calibrated_scene.prepend(document, shape, [file, normals])
    calibrated_scene.write_document(document, copy)


def cell_mesh(plane: MaskPlane, opaque: Cells) -> TriangleMesh:
    """Return a mesh, in the scene's coordinates, of a rectangle's opaque cells, (rows, columns).

    Each row's runs of opaque cells are rectangles that share no vertex: each is convex, as closed
    forms ask for.
    """
    steps = np.diff(opaque.astype(int), axis=1, prepend=0, append=0)
    row, left = np.nonzero(steps > 0)
    _, right = np.nonzero(steps < 0)
    ends = np.stack([left, row, right, row, right, row + 1, left, row + 1], axis=-1)
    vertices = plane.points(ends.reshape(-1, 2) / opaque.shape[::-1])
    faces = 4 * np.arange(len(row))[:, None, None] + np.array([[0, 2, 1], [0, 3, 2]])
    return TriangleMesh(vertices, faces.reshape(-1, 3))


ALLOWANCES, STEPS = (1e-1, 1e-2, 0.0), 30
"""Fractions τ of a descent, one after the other, and how many steps are taken with each. On two
photographs of the tests' flag 12 of 12 descents end at the true mask; where α shrinks in their
place, 9 of 12."""

STARTS, FINALISTS = 6, 3
"""Random masks of few cells that the search begins with; of where they lead, followed to all cells.
For a letter F of 16 x 16 cells, 9 of 12 descents with 8 x 8 end near it, with 16 x 16 one of 6."""

SMOOTH = 1 / 6
"""Deviation of the Gaussian that smooths random masks, over the cells along a side."""

AGREEING = 0.6
"""Cells opaque in both of two masks, over those opaque in either, from which they are one; masks of
few cells have coarse edges."""


@dataclass(frozen=True, eq=False)
class UnknownImage:
    """The likelihood of a photograph, (M, 3), of an image that is nowhere negative."""

    photograph: Array  # (M, C)
    background: Array  # (M, r) orthonormal basis of range(B)
    images: SmoothImages  # of patches
    ratio: float = 1.0  # α
    allowance: float = 0.0  # τ

    def at(self, A: Matrix, allowance: float) -> UnknownImage:
        """Return this with another allowance, and the α that a matrix has for any image."""
        ratios = self.images.explain(A, self.background, self.photograph).ratios
        return replace(self, ratio=float(np.exp(np.log(ratios).mean())), allowance=allowance)

    def __call__(self, A: Matrix) -> Explained:
        """Explain the photograph by a matrix, (M, N)."""
        X, y = self._projected(A), self._projected(self.photograph)
        K, α, channels = self.images.precision, self.ratio, y.shape[1]
        X64 = X.astype(float)  # in single precision H need not be positive definite
        H = X64.T @ X64 + α * K
        correlation = X64.T @ y
        factor = linalg.cholesky(H, check_finite=False)
        whitened = linalg.solve_triangular(factor, correlation, trans="T", check_finite=False)
        image = np.column_stack([nnls(factor, column)[0] for column in whitened.T])
        energy = np.sum(y**2, axis=0)
        least = self.allowance + ROUNDING**2
        misfit = np.maximum(energy - np.sum(image * correlation, axis=0), 0) + least * energy
        freedom = len(y) - self.background.shape[1]
        volume = 2 * np.log(np.diag(factor)).sum() - np.linalg.slogdet(α * K)[1]
        inverse = linalg.cho_solve((factor, False), np.eye(len(H))).astype(np.float32)
        residual = y - X @ image
        pull = (freedom / misfit * residual).astype(np.float32) @ image.T.astype(np.float32)
        return Explained(
            float(freedom * np.log(misfit).sum() + channels * volume),
            self._projected(channels * X @ inverse - pull),
            image,
            residual[None],
        )

    def _projected(self, light: Matrix) -> Matrix:
        """Return light, (M, n), with range(B) projected out."""
        Q = self.background.astype(light.dtype)
        return light - Q @ (Q.T @ light)


@dataclass(frozen=True, eq=False)
class MaskEnd:
    """The end of a descent, with the plane so many times as far from the monitor as measured."""

    scale: float
    plane: MaskPlane
    mask: Mask
    likelihood: Likelihood
    fit: MaskFit

    @property
    def objective(self) -> float:
        """Negative logarithm of the posterior density."""
        return self.fit.objective


@dataclass(frozen=True, eq=False)
class MaskedWall:
    """A photograph of the wall, before which a mask stands in an occluder's place."""

    scene: Geometry  # seen in the photograph's pixels
    name: str
    photograph: Photograph
    transport: NDArray[np.float32]  # (M, N) without the occluder
    background: Array  # (M, r) orthonormal basis of range(B)

    @classmethod
    def of(cls, scenario: Geometry, name: str, hidden: Hidden, photograph: Photograph) -> Self:
        """Return the wall of a scene without an occluder of a name."""
        scene, camera, shape = scenario.scene, scenario.view.camera, photograph.shape
        view, used = View.of(scene, shape, camera=camera), photograph.pixels
        fine = View.of(scene, shape, across=points_across(shape), camera=camera).of_pixels(used)
        A = area_transport(Geometry(replace(fine, scene=scene.without(name)), hidden))
        Q = problem.ambient_basis(view, used, photograph)
        return cls(Geometry(view, hidden), name, photograph, A, Q)

    def mask(self, plane: MaskPlane, cells: tuple[int, int]) -> Mask:
        """Return a mask in a plane."""
        used = self.photograph.pixels
        shadows = CellShadows.of(self.transport, self.scene, plane, cells, used)
        if not shadows.light.any():
            raise SceneError(
                f"scene '{self.scene.path}': occluder '{self.name}' casts no shadow of the monitor "
                "into what the camera sees of the wall, wherever in its rectangle it is opaque"
            )
        return Mask.of(cells, shadows, used)


@dataclass(frozen=True, eq=False)
class Level:
    """A photograph of an unknown image behind masks of (rows, columns) cells."""

    wall: MaskedWall
    cells: tuple[int, int]

    @cached_property
    def image(self) -> UnknownImage:
        """The likelihood."""
        hidden, y = self.wall.scene.hidden, self.wall.photograph.used
        return UnknownImage(y, self.wall.background, SmoothImages.hats(hidden, hidden))

    def descend(
        self, scale: float, plane: MaskPlane, opacities: Array, gain: Array | None,
        allowances: Sequence[float],
    ) -> MaskEnd:  # fmt: skip
        """Return where a descent ends, with one allowance after the other."""
        mask, image = self.wall.mask(plane, self.cells), self.image
        gain = np.zeros(len(mask.terms)) if gain is None else gain
        for allowance in allowances:
            likelihood = image.at(mask.transport(opacities, gain), allowance)
            fit = mask.descend(opacities, gain, likelihood, STEPS)
            opacities, gain = fit.opacities, fit.gain
        likelihood = image.at(mask.transport(opacities, gain), 0.0)
        return MaskEnd(scale, plane, mask, likelihood, mask.fit(opacities, gain, likelihood))


def search(
    coarse: Level, fine: Level, depth: Depth, seed: int, report: Callable[[float], None]
) -> tuple[MaskEnd, Depth, Sequence[bool]]:
    """Return the best mask, its depth, and which of the starts ended near it."""

    def moved(end: MaskEnd, plane: MaskPlane, cells: tuple[int, int]) -> Array:
        return plane.seen_through(end.plane, depth.monitor, end.fit.opacities, cells)

    def beside(scale: float, end: MaskEnd) -> MaskEnd:
        plane = depth.plane(scale)
        start = moved(end, plane, fine.cells)
        if end.mask.cells != fine.cells:
            start = np.minimum(start / usual_opacity(end.fit.opacities), 1.0)
        return fine.descend(scale, plane, start, end.fit.gain, ALLOWANCES[1:])

    done = 0

    def from_random(scale: float) -> Iterator[MaskEnd]:
        nonlocal done
        for k in range(STARTS):
            start = _random_opacities(coarse.cells, [seed, k])
            yield coarse.descend(scale, depth.plane(scale), start, None, ALLOWANCES)
            done += 1
            report(0.4 * done / STARTS / len(depth.scales))

    ends = depth.scanned(from_random)
    scales = [end.scale for end in ends]
    ranks = [scales[:k].count(scale) for k, scale in enumerate(scales)]
    distinct = [ends[k] for k in np.argsort(ranks, kind="stable")]  # the best of each depth first
    followed = []
    for number, end in enumerate(distinct[:FINALISTS], 1):
        followed.append(beside(end.scale, end))
        report(0.4 + 0.3 * number / FINALISTS)
    best = min(followed, key=depth.objective)
    best, depth = depth.refined(best, beside, lambda part: report(0.7 + 0.3 * part), MARGINS)
    ours = opaque(best.fit.opacities)
    masks = [opaque(moved(end, best.plane, ours.shape)) for end in ends]
    return best, depth, [bool((ours & m).sum() >= AGREEING * (ours | m).sum()) for m in masks]


def _random_opacities(cells: tuple[int, int], seed: Sequence[int]) -> Array:
    """Return random opacities, (rows, columns), of a few smooth pieces.

    Rougher starts end at small dots before an image of their shadow.
    """
    rough = np.random.default_rng(seed).standard_normal(cells)
    noise = gaussian_filter(rough, SMOOTH * np.array(cells), mode="reflect")
    return np.asarray(ndtr((noise - noise.mean()) / max(float(noise.std()), 1e-300)))


FEW = 8
"""Cells of first descents along the longer side, at most: a letter F of 16 x 16 is found from 8 x
8. Pixels are about as large as a cell's shadow: by half as large ones, the objective of a real
photograph prefers a wrong depth, for what cells cannot follow counts as evidence."""

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
    fewest = moving_scene.LARGEST // (2 if shown else 4)
    pixels = int(np.clip(needed, fewest, moving_scene.LARGEST))
    photographs = [each.unmixed() for each in of_one_wall(photograph, size)]
    if len(photographs) != max(1, len(shown)):
        raise PhotographError(
            f"{len(photographs)} photographs of {len(shown)} shown pictures: give a photograph of "
            "each picture, or one photograph of an unknown one"
        )
    averaged = [
        averaged_photograph(each, moving_scene.limit_size(size, pixels)) for each in photographs
    ]
    sizes = moving_scene.limit_sizes(
        scenario.hidden, problem.MOST_PATCHES if shown else problem.COARSE_HATS
    )
    patches = Hidden.of_scene(scenario.scene, sizes)
    depth = Depth.of(scenario, shape, plane)
    wall = partial(MaskedWall.of, scenario, shape, patches)
    agreeing: Sequence[bool] = ()
    # Products this small gain less from threads than these cost, see `calibrate`.
    with threadpool_limits(1):
        if shown:
            pictures = [problem.shown_light(each, patches) for each in shown]
            behind = _behind_pictures(wall(averaged[0]), cells, averaged, pictures, depth)
            first = depth.scanned(lambda scale: [behind(scale)])[0]
            end, depth = depth.refined(first, behind, report)
        else:
            rows, columns = np.minimum(cells, plane.square_cells(FEW)).tolist()
            small = averaged_photograph(photographs[0], moving_scene.limit_size(size, pixels // 2))
            coarse = Level(wall(small), (rows, columns))
            fine = Level(wall(averaged[0]), cells)
            end, depth, agreeing = search(coarse, fine, depth, seed, report)
        without = end.mask.fit(np.zeros(cells), end.fit.gain, end.likelihood)
    if not trust.is_significant(
        2 * (without.objective - end.fit.objective), end.fit.opacities.size
    ):
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
        plane=end.plane,
        depth=depth,
        opacities=end.fit.opacities,
        seen=(shadow > UNSEEN * shadow.max()).reshape(cells),
        image=patches.image(explained.image),
        unexplained=unexplained,
        unexplained_open=unexplained_open,
        residual=residual,
        evidence=explained.cost,
        agreeing=sum(agreeing),
        starts=len(agreeing),
    )


def _behind_pictures(
    wall: MaskedWall,
    cells: tuple[int, int],
    photographs: Sequence[Photograph],
    pictures: Sequence[Array],
    depth: Depth,
) -> Callable[..., MaskEnd]:
    """Return where descents behind known pictures, (N, P) each, end, by the scale.

    Each is from half opaque cells, or from the opacities of another end.
    """
    likelihood = known_pictures(wall.background, [each.used for each in photographs], pictures)

    def end(scale: float, start: MaskEnd | None = None) -> MaskEnd:
        mask = wall.mask(plane := depth.plane(scale), cells)
        mask = replace(mask, shadows=mask.shadows.before(np.hstack(pictures)))
        opacities, gain = np.full(cells, 0.5), np.zeros(len(mask.terms))
        if start is not None:
            masks, gain = start.fit.opacities, start.fit.gain
            opacities = plane.seen_through(start.plane, depth.monitor, masks, cells)
        return MaskEnd(scale, plane, mask, likelihood, mask.descend(opacities, gain, likelihood))

    return end
