"""What was found of a case, and what it is worth."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace
from pathlib import Path
from tempfile import TemporaryDirectory

import numpy as np
from numpy.typing import NDArray

import periscopy_sim as ps
from experiments.page import processor_seconds
from experiments.studies.silhouettes.subjects import Sought, Subject
from periscopy_sim.calibration.silhouette.scene import write_masked_scene

Array = NDArray[np.float64]
Cells = NDArray[np.bool_]

FARTHEST = 4
"""Cells by which a mask is shifted to be compared, at most, along either axis."""


@dataclass(frozen=True)
class Shared:
    """How far two masks agree: cells opaque in both, of those opaque in either.

    Attributes
    ----------
    standing, shifted
        As they stand, and after the shift by whole cells that is best.
    down, right
        That shift, of the mask found.
    """

    standing: float
    shifted: float
    down: int
    right: int


def shared(found: Cells, true: Cells) -> Shared:
    """Compare a mask that was found with the true one; among equal shifts the smallest is taken."""
    reach = range(-FARTHEST, FARTHEST + 1)
    shifts = sorted(((d, r) for d in reach for r in reach), key=lambda s: s[0] ** 2 + s[1] ** 2)
    parts = [_part(shifted(found, *shift), true) for shift in shifts]
    best = int(np.argmax(parts))
    return Shared(parts[0], parts[best], *shifts[best])


def shifted(cells: Cells, down: int, right: int) -> Cells:
    """Return a mask shifted by whole cells; what comes in is open."""
    rows, columns = cells.shape
    wide = np.pad(cells, FARTHEST)
    top, left = FARTHEST - down, FARTHEST - right
    return wide[top : top + rows, left : left + columns]


def _part(one: Cells, other: Cells) -> float:
    """Return the cells of both masks over those of either; 1 if both are open."""
    either = np.count_nonzero(one | other)
    return float(np.count_nonzero(one & other) / either) if either else 1.0


@dataclass(frozen=True, eq=False)
class Outcome:
    """A case.

    Attributes
    ----------
    name, image, sbr
        Of the case, its hidden image and its signal-to-background ratio; that of a real photograph
        is None.
    opaque, seen
        (rows, columns) the mask found, and which of its cells the photograph shows.
    outline
        (rows n, columns n) the true one, see `subjects.Truth`.
    sides
        Height and width of the rectangle, in metres.
    truth, placed
        What the monitor showed, and whether it is known where on it.
    found_image, flat_image, true_image
        (R, C, 3) by the noise-aware method: with the mask found, with the true occluder's outline
        cut into the same flat cells, and with the true occluder.
    unexplained, unexplained_open, overdispersion, told
        See `periscopy_sim.Silhouette`.
    doubts
        Why the mask is not to be trusted.
    seconds
        Of processors' time that the search took.
    """

    name: str
    image: str
    sbr: float | None
    opaque: Cells
    seen: Cells
    outline: Cells
    sides: list[float]
    truth: Array
    placed: bool
    found_image: Array
    flat_image: Array
    true_image: Array
    unexplained: float
    unexplained_open: float
    overdispersion: float
    told: float
    doubts: list[str]
    seconds: float

    @property
    def trusted(self) -> bool:
        """Whether nothing speaks against the mask."""
        return not self.doubts

    @property
    def shared(self) -> Shared:
        """How far the mask found is the true one."""
        return shared(self.opaque, cells_covered(self.outline, self.opaque.shape))

    def decibels(self, image: Array) -> tuple[float, float] | None:
        """Return an image's PSNR as it stands and registered; None where there is no truth."""
        if not self.placed:
            return None
        return ps.psnr(image, self.truth), ps.registered(image, self.truth).psnr


def cells_covered(outline: Cells, cells: tuple[int, ...]) -> Cells:
    """Return which of (rows, columns) cells an outline, (rows n, columns n), covers by half."""
    rows, columns = cells
    parts = outline.reshape(rows, len(outline) // rows, columns, -1)
    return np.asarray(parts.mean(axis=(1, 3)) >= 0.5)


def outcome(subject: Subject, progress: Callable[[float], None] | None = None) -> Outcome:
    """Search for a silhouette; recover the image by it, by the true cells and the true occluder."""
    sought, truth = subject.sought, subject.truth
    begun = processor_seconds()
    found = searched(sought, progress)
    taken = processor_seconds() - begun
    flat = replace(found, opaque=cells_covered(truth.outline, found.opaque.shape))
    return Outcome(
        name=subject.name,
        image=subject.image,
        sbr=subject.sbr,
        opaque=found.opaque,
        seen=found.seen,
        outline=truth.outline,
        sides=list(found.plane.sides),
        truth=truth.image,
        placed=truth.placed,
        found_image=recovered_with(found, sought),
        flat_image=recovered_with(flat, sought),
        true_image=recovered(truth.scene, sought),
        unexplained=found.unexplained,
        unexplained_open=found.unexplained_open,
        overdispersion=found.overdispersion,
        told=found.told,
        doubts=list(found.doubts),
        seconds=taken,
    )


def searched(sought: Sought, progress: Callable[[float], None] | None = None) -> ps.Silhouette:
    """Search for a silhouette by what the search is given, and no more."""
    return ps.recover_silhouette(
        sought.photograph,
        sought.scene,
        sought.hidden,
        sought.shape,
        sought.cells,
        parameters=sought.parameters,
        mask=sought.used,
        progress=progress,
    )


def recovered_with(mask: ps.Silhouette, sought: Sought) -> Array:
    """Return the image, (R, C, 3), that the noise-aware method recovers with a flat mask."""
    with TemporaryDirectory() as folder:
        scene, mesh = Path(folder) / "found.xml", Path(folder) / "found.ply"
        write_masked_scene(sought.scene, mask, sought.parameters, scene, mesh, mesh.name)
        return recovered(scene, sought)


def recovered(path: Path, sought: Sought) -> Array:
    """Return the image, (R, C, 3), that the noise-aware method recovers with a scene."""
    scene = ps.load_scenario(path, sought.hidden, sought.parameters)
    A, B = ps.render_transport(scene), ps.point_light_backgrounds(scene)
    method = ps.NoiseAware.for_scene(scene, A, B, mask=sought.used)
    return np.asarray(method.reconstruct(sought.photograph), np.float64)
