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
from scipy.optimize import minimize

from periscopy_sim.calibration.silhouette.mask import MaskFit, outline
from periscopy_sim.calibration.silhouette.shadows import CellShadows
from periscopy_sim.scenario import Array

ROUNDING = 1e-10
"""Fraction of a photograph's energy below which a misfit is rounding."""

COLOURLESS = 1e-6
"""Of a picture's colours: a part of them so much weaker than the others tells nothing."""

STEPS = 500
"""Of a descent, at most; about 70 as a rule."""


@dataclass(frozen=True, eq=False)
class KnownPictures:
    """Photographs, (M, 3) each, of known pictures behind a mask of (rows, columns) cells."""

    cells: tuple[int, int]
    background: Array  # (M, r) orthonormal basis of range(B)
    photographs: Sequence[Array]  # y⊥
    pictures: Sequence[Array]  # (N, 3) F
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
        return cls(cells, background, [projected(y) for y in photographs], pictures, lights)

    def explain(self, opacities: Array) -> MaskFit:
        """Return what opacities, (rows, columns), explain: E = Σ F log ‖y⊥ − X m‖²."""
        prior, slope = outline(opacities)
        evidence, gradient = 0.0, slope.ravel()
        images, residuals = [], []
        freedom = len(self.background) - self.background.shape[1]
        for y, f, (light, blocked) in zip(
            self.photographs, self.pictures, self.lights, strict=True
        ):
            X = light - np.tensordot(opacities.ravel(), blocked, 1)
            mixture = np.linalg.lstsq(X, y, rcond=COLOURLESS)[0]
            residual = y - X @ mixture
            energy = np.sum(y**2, axis=0)
            misfit = np.sum(residual**2, axis=0) + ROUNDING * energy
            evidence += freedom * float(np.log(misfit / energy).sum())
            pull = freedom * (residual / misfit) @ mixture.T
            gradient = gradient + np.tensordot(blocked, pull, 2)
            images.append(f @ mixture)
            residuals.append(residual)
        objective = evidence / 2 + prior
        return MaskFit(opacities, evidence, objective, gradient, images[0], np.array(residuals))

    def descend(self) -> MaskFit:
        """Return the best mask, from one that is half opaque everywhere (L-BFGS-B)."""

        def objective(o: Array) -> tuple[float, Array]:
            fit = self.explain(o.reshape(self.cells))
            return fit.objective, fit.gradient

        count = self.cells[0] * self.cells[1]
        end = minimize(
            objective, np.full(count, 0.5), jac=True, method="L-BFGS-B",
            bounds=[(0.0, 1.0)] * count, options={"maxiter": STEPS},
        )  # fmt: skip
        return self.explain(np.asarray(end.x).reshape(self.cells))
