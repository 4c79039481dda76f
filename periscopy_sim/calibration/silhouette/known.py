"""The mask behind which known pictures make photographs: least squares, as light is linear in it.

    y_pc = (A₀ − Σ_k o_k A_k) F_p m_pc + B b_pc + n_pc,   0 ≤ o ≤ 1,

F_p, (N, 3), the p-th picture, m_pc how channel c of its photograph mixes its colours, and B the
ambient light. Mixture, ambient light and the noise's deviation are eliminated (variable projection:
Golub and Pereyra, SIAM J. Numer. Anal. 10, 1973); a short outline is preferred.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from periscopy_sim.calibration.silhouette.outline import outline
from periscopy_sim.calibration.silhouette.shadows import CellShadows
from periscopy_sim.scenario import Array

ROUNDING = 1e-10
"""Fraction of a photograph's energy below which a misfit is rounding."""


@dataclass(frozen=True, eq=False)
class KnownFit:
    """What opacities explain: the evidence E and its gradient, (K,), the mixtures and residuals.

    Of P photographs these are (3, 3) and (P, M, 3).
    """

    evidence: float
    gradient: Array
    mixtures: list[Array]
    residual: Array


@dataclass(frozen=True, eq=False)
class KnownPictures:
    """Photographs, (M, 3) each, of known pictures behind a mask of (rows, columns) cells."""

    cells: tuple[int, int]
    background: Array  # (M, r) orthonormal basis of range(B)
    photographs: Sequence[Array]  # y⊥
    lights: Sequence[tuple[Array, Array]]  # (M, 3) A₀ F and (K, M, 3) A_k F, both ⊥

    @classmethod
    def of(
        cls,
        shadows: CellShadows,
        cells: tuple[int, int],
        background: Array,
        photographs: Sequence[Array],
        pictures: Sequence[Array],
    ) -> KnownPictures:
        """Prepare photographs and their pictures, (N, 3)."""

        def projected(light: Array) -> Array:
            return light - background @ (background.T @ light)

        lights = [(projected(shadows.open @ f), projected(shadows.of_image(f))) for f in pictures]
        return cls(cells, background, [projected(y) for y in photographs], lights)

    def __call__(self, opacities: Array) -> tuple[float, Array]:
        """Return half the negative logarithm of the posterior, and its gradient, (K,)."""
        fit = self.explain(opacities)
        prior, slope = outline(opacities.reshape(self.cells))
        return fit.evidence / 2 + prior, fit.gradient / 2 + slope.ravel()

    def explain(self, opacities: Array) -> KnownFit:
        """Return what opacities, (K,), explain: E = Σ F log ‖y⊥ − X m‖² over all channels."""
        evidence, gradient = 0.0, np.zeros(len(opacities))
        mixtures, residuals = [], []
        freedom = len(self.background) - self.background.shape[1]
        for y, (light, blocked) in zip(self.photographs, self.lights, strict=True):
            X = light - np.tensordot(opacities, blocked, 1)
            mixture = np.linalg.lstsq(X, y, rcond=1e-6)[0]
            residual = y - X @ mixture
            energy = np.sum(y**2, axis=0)
            misfit = np.sum(residual**2, axis=0) + ROUNDING * energy
            evidence += freedom * float(np.log(misfit / energy).sum())
            gradient += 2 * freedom * np.tensordot(blocked, (residual / misfit) @ mixture.T, 2)
            mixtures.append(mixture)
            residuals.append(residual)
        return KnownFit(evidence, gradient, mixtures, np.array(residuals))
