"""A photograph at one resolution, explained by a mask of cells, whatever the hidden image."""

from __future__ import annotations

from dataclasses import dataclass, replace
from functools import cached_property
from typing import Self

import numpy as np
from numpy.typing import NDArray

from periscopy_sim.calibration.explanation.evidence import Explanation
from periscopy_sim.calibration.explanation.overdispersion import overdispersion
from periscopy_sim.calibration.explanation.resolution_level import ResolutionLevel
from periscopy_sim.calibration.silhouette.cells.cell_shadows import CellShadows
from periscopy_sim.calibration.silhouette.cells.mask_plane import MaskPlane
from periscopy_sim.calibration.silhouette.search.mask_evidence import MaskEvidence
from periscopy_sim.calibration.silhouette.search.mask_prior import improbability
from periscopy_sim.scenario import Array

NOTHING = np.zeros(0)
"""Values of a level whose scene has no parameters that vary."""


@dataclass(frozen=True, eq=False)
class MaskFit:
    """Opacities of a mask's cells, (rows, columns), and what they explain."""

    opacities: Array
    explanation: Explanation
    objective: float

    @property
    def opaque(self) -> NDArray[np.bool_]:
        """(rows, columns) whether cells are opaque rather than not."""
        return opaque(self.opacities)


@dataclass(frozen=True, eq=False)
class MaskLevel:
    """A photograph at one resolution, explained by a mask of (rows, columns) of cells.

    The level's scene is without the mask, and its images are nonnegative: that is what tells most
    masks from the right one, see `mask_evidence`.
    """

    level: ResolutionLevel
    shadows: CellShadows
    cells: tuple[int, int]

    @classmethod
    def of(cls, level: ResolutionLevel, plane: MaskPlane, cells: tuple[int, int]) -> Self:
        """Return that of a mask in a plane."""
        A, scenario = level.matrix(NOTHING), level.scenario(NOTHING)
        return cls(
            level.of_nonnegative_images(),
            CellShadows.of(A, scenario, plane, cells, level.used),
            cells,
        )

    @cached_property
    def evidence(self) -> MaskEvidence:
        """What the search for a mask descends."""
        return MaskEvidence.of(self.shadows, self.level, self.level.background(NOTHING))

    def explain(self, opacities: Array) -> MaskFit:
        """Explain the photograph by opacities, (rows, columns)."""
        found = self.level.explained_by(self.shadows.matrix(opacities.ravel()), NOTHING)
        return MaskFit(opacities, found, found.evidence / 2 + improbability(opacities)[0])

    def learned(self, found: Explanation) -> Self:
        """Return the same level with what an explanation tells beside the mask.

        That is the wall's unevenness, the gain over it, and how strong its errors are.
        """
        level = self.level.evened(found).gained(found)
        κ = overdispersion(found, level.used, level.seed)
        return replace(self, level=level.overdispersed(κ))

    def linearized(self, here: MaskFit) -> tuple[Array, Array]:
        """Return the gradient, (K,), and the information, (K, K), of half the evidence."""
        found = here.explanation
        g = -self.shadows.along(found.gradient) / 2
        H = found.fit.information(found.moved(self.shadows.held_off(found.images)))
        return g, H


def opaque(opacities: Array) -> NDArray[np.bool_]:
    """Return whether cells, (rows, columns), are opaque rather than not.

    Half of what is usual among those that are counts: a fainter mask before a brighter image makes
    nearly the same photograph.
    """
    return np.asarray(opacities > usual_opacity(opacities) / 2)


def usual_opacity(opacities: Array) -> float:
    """Return the mean opacity of cells, (rows, columns), each as often as it is opaque."""
    return float(np.sum(opacities**2) / max(float(opacities.sum()), 1e-300))
