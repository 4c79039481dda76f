"""Descent to the opacities of a mask's cells that explain a photograph best.

    J(m) = E(m) / 2 + improbability of m,   0 ≤ m ≤ 1

by a quasi-Newton method within bounds (L-BFGS-B: Byrd, Lu, Nocedal and Zhu, SIAM J. Sci. Comput.
16, 1995). Blind deconvolution has many local minima: it begins at smooth random masks, about half
open, since one of small dots before an image of the mask's shadow is where others end; and what
need not be explained yet is lowered in steps (`MaskEvidence`).
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.optimize import minimize

from periscopy_sim.calibration.silhouette.search.mask_evidence import MaskEvidence
from periscopy_sim.calibration.silhouette.search.mask_level import opaque
from periscopy_sim.calibration.silhouette.search.mask_prior import improbability
from periscopy_sim.scenario import Array

Stages = tuple[tuple[float, int], ...]
"""Allowances and how many steps are taken with each."""

FROM_AFAR: Stages = ((1e-1, 20), (1e-2, 20), (0.0, 30))
NEARBY: Stages = ((1e-3, 20), (0.0, 30))
ONWARD: Stages = ((0.0, 30),)

SMOOTH = 1 / 6
"""Of the cells along a side: the deviation of the Gaussian that random masks are smoothed by."""

FILLED = 0.3, 0.6
"""Part of a random mask that is more opaque than open, from and to."""

STEEPNESS = 2.0
"""Of opacities by the smoothed noise, in its deviations."""


@dataclass(frozen=True, eq=False)
class Descended:
    """Opacities, (rows, columns), where a descent ended, and J there."""

    opacities: Array
    objective: float

    @property
    def opaque(self) -> NDArray[np.bool_]:
        """(rows, columns) whether cells are opaque rather than not."""
        return opaque(self.opacities)


def descend(evidence: MaskEvidence, start: Array, stages: Stages) -> Descended:
    """Walk downhill from opacities, (rows, columns)."""
    shape, m = start.shape, start.ravel()
    images = np.ones((len(evidence.smoothness), 3))

    def objective(m: Array, α: float, allowance: float) -> tuple[float, Array]:
        nonlocal images
        total, gradient, images = evidence.at(m, α, allowance, images)
        prior, slope = improbability(m.reshape(shape))
        return total / 2 + prior, gradient / 2 + slope.ravel()

    for allowance, steps in stages:
        α = evidence.best_ratio(m, allowance)
        found = minimize(
            objective, m, args=(α, allowance), jac=True, method="L-BFGS-B",
            bounds=[(0.0, 1.0)] * len(m), options={"maxiter": steps, "maxcor": 15},
        )  # fmt: skip
        m = found.x
    return Descended(np.asarray(m).reshape(shape), float(found.fun))


def smooth_mask(cells: tuple[int, int], random: np.random.Generator) -> Array:
    """Return a random mask, (rows, columns), of a few smooth pieces."""
    from scipy.ndimage import gaussian_filter

    noise = gaussian_filter(random.standard_normal(cells), SMOOTH * np.array(cells), mode="reflect")
    height = noise - np.quantile(noise, 1 - random.uniform(*FILLED))
    return np.asarray(1 / (1 + np.exp(-STEEPNESS * height / max(float(noise.std()), 1e-300))))
