"""Which parameters only shift the hidden image, so that a photograph finds them up to patches.

A monitor that moves in its own plane while its image moves the other way sends out the same light.
Only its border tells: where nothing shines any more. Between one patch of shift and the next the
evidence has a dip, whatever is true, for an image on a grid must be shifted by whole patches.

What moves an occluder, too, is found up to patches for another reason: see `image_warp`.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Self

import numpy as np
from numpy.typing import NDArray

from periscopy_sim.calibration.explanation.evidence import Explanation
from periscopy_sim.calibration.explanation.resolution_level import ResolutionLevel, Values
from periscopy_sim.calibration.prior import Prior
from periscopy_sim.errors import SceneError
from periscopy_sim.rendering.scene.load import load_scenario
from periscopy_sim.scenario import Array, Occluder, Scenario

OUT_OF_PLANE = 0.25
"""Part of a shift, at most, that leads out of the monitor's plane: 14 degrees."""

SAME = 1e-6
"""Of the largest coordinate: within it points are the same, known to single precision."""

BETWEEN_PATCHES = 0.1
"""Part of a likelihood by which it counts between whole patches. Wrong patches were found better by
up to 40 of evidence, as much as right ones elsewhere (`experiments.laboratories`)."""

NEGLIGIBLE = 5.0
"""Difference of evidence for which nobody moves: the rays change it by more."""

WHOLE = 0.1
"""Of a patch: how far from a whole one a shift may be."""

UNRULED = 0.01
"""Of a unit: how far a parameter is moved that no ruler knows, to see what it does."""


@dataclass(frozen=True, eq=False)
class ImageShift:
    """By how much each parameter of a scene shifts the hidden image, if it does nothing else."""

    patches: Array  # (2, P) across and up, by a unit of each parameter; 0 of those that do else

    @classmethod
    def none(cls, parameters: int) -> Self:
        """Return that of some parameters none of which shifts the image alone."""
        return cls(np.zeros((2, parameters)))

    @classmethod
    def of(
        cls,
        path: Path,
        hidden: tuple[int, int],
        given: Mapping[str, str],
        names: Sequence[str],
        prior: Prior,
    ) -> Self:
        """Return that of a scene's parameters, each moved by its ruler's error to either side.

        The prior, of the names, is about the values that the parameters are given. One that can be
        moved to neither side shifts nothing.
        """
        here = load_scenario(path, hidden, given)
        across, up = here.patch_across.mean(axis=0), here.patch_up.mean(axis=0)
        to_patches = np.linalg.pinv(np.stack([across, up], axis=1))
        patches = np.zeros((2, len(names)))
        for k, (name, center, error) in enumerate(
            zip(names, prior.centers, prior.errors, strict=True)
        ):
            move = error if np.isfinite(error) else UNRULED
            for offset in (move, -move):
                try:
                    there = load_scenario(path, hidden, {**given, name: f"{center + offset:.17g}"})
                except SceneError:
                    continue
                if shifts_image(here, there):
                    shift = (there.patch_centers - here.patch_centers).mean(axis=0)
                    patches[:, k] = to_patches @ shift / offset
                break
        return cls(patches)

    @property
    def by_patch(self) -> Array:
        """(P, 2) how far parameters move to shift the image by a patch, across and up.

        0 along an axis along which they cannot shift it alone.
        """
        moves = np.linalg.pinv(self.patches)
        return np.where(np.abs(np.diag(self.patches @ moves) - 1) < WHOLE, moves, 0.0)

    @property
    def alone(self) -> NDArray[np.bool_]:
        """(P,) whether a parameter does nothing else."""
        return np.asarray(self.patches.any(axis=0))

    def nearest(self, values: Values, start: Values) -> Values:
        """Return values, (P,), shifted by whole patches to where they are nearest a start's.

        Along an axis along which they cannot shift the image alone, they stay.
        """
        whole = np.rint(self.patches @ (values - start))
        return np.asarray(values - self.by_patch @ whole)

    def settled(
        self, level: ResolutionLevel, values: Values, seen: Explanation
    ) -> tuple[Values, Explanation]:
        """Return the values `nearest` the ruler's, and what is seen there.

        If the photograph tells them from those given, as it does by the border, these are returned.
        """
        near = self.nearest(values, level.prior.centers)
        if np.array_equal(near, values):
            return values, seen
        try:
            there = level.judged(near)
        except SceneError:
            return values, seen
        loss = between_patches(level, near, there) - between_patches(level, values, seen)
        worse = loss > BETWEEN_PATCHES * NEGLIGIBLE
        return (values, seen) if worse else (near, there)


def between_patches(level: ResolutionLevel, values: Values, seen: Explanation) -> float:
    """Return by what places whole patches apart compare, the less the better.

    It is the ruler's penalty and the part of the likelihood that counts there. Within a patch the
    photograph tells places by its shadows, and the evidence counts as it is.
    """
    penalty = level.prior.penalty(values)
    return penalty + BETWEEN_PATCHES * (seen.evidence - penalty)


def shifts_image(here: Scenario, moved: Scenario) -> bool:
    """Return whether a scene differs from another by a shift of its monitor in its plane alone."""
    shifts = moved.patch_centers - here.patch_centers
    shift = shifts.mean(axis=0)
    out = np.abs(here.patch_normals @ shift).max()
    if out >= OUT_OF_PLANE * np.linalg.norm(shift):
        return False
    still = [
        (shifts, np.broadcast_to(shift, shifts.shape)),
        (here.patch_normals, moved.patch_normals),
        (here.patch_across, moved.patch_across),
        (here.patch_up, moved.patch_up),
        (here.wall_points, moved.wall_points),
        *((_outline(a), _outline(b)) for a, b in zip(here.occluders, moved.occluders, strict=True)),
    ]
    same = SAME * max(np.abs(points).max() for points in (here.wall_points, here.patch_centers))
    return all(
        a is not None and b is not None and a.shape == b.shape and np.abs(a - b).max() <= same
        for a, b in still
    )


def _outline(occluder: Occluder) -> Array | None:
    """Return points that tell where an occluder stands: a mesh's own, of others the box's."""
    return occluder.bounds if occluder.vertices is None else occluder.vertices
