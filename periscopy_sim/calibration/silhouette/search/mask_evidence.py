"""The evidence that the search for a mask descends: that of `explanation.evidence`, made quick.

    E(m) = (Σ_c F log(S_c + τ ‖y⊥_c‖²) + 3 log |A⊥ᵀA⊥ + α K| / |α K|) / κ
    S_c = min ‖y⊥_c − A⊥(m) f‖² + α fᵀK f  over f ≥ 0

One α serves all three channels, and is held while opacities move. That nothing shines negatively is
what tells most masks from the right one: without it a wrong one explains a photograph nearly as
well. The allowance τ is a part of the photograph that need not be explained yet: the larger, the
smoother is E, and the fewer its local minima (it is lowered in steps). κ is the overdispersion.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Self

import numpy as np
from numpy.typing import NDArray
from scipy import linalg

from periscopy_sim.calibration.explanation.image_fit import nonnegative_fit
from periscopy_sim.calibration.explanation.image_prior import image_precision
from periscopy_sim.calibration.explanation.resolution_level import ResolutionLevel
from periscopy_sim.calibration.silhouette.cells.cell_shadows import CellShadows
from periscopy_sim.scenario import Array

RATIOS = np.geomspace(1e-7, 1e2, 40)
"""Values of α that are tried, over the mean energy of a patch."""

LEAST = 1e-12
"""Of the photograph's energy: below it is rounding, not misfit."""

Single = NDArray[np.float32]


@dataclass(frozen=True, eq=False)
class MaskEvidence:
    """A photograph and the light that each cell holds off, without ambient light."""

    shadows: CellShadows
    background: Single  # (M, r) orthonormal basis of range(B)
    photograph: Array  # (M, 3) y⊥
    smoothness: Array  # (N, N) K
    gain: Single  # (M,) over the wall, of A
    overdispersion: float  # κ

    @classmethod
    def of(cls, shadows: CellShadows, level: ResolutionLevel, background: Array) -> Self:
        """Return that of a level's photograph and an orthonormal basis of range(B), (M, r)."""
        K = image_precision(level.hidden_shape)
        rest = level.light - background @ (background.T @ level.light)
        single = background.astype(np.float32), level.gain.astype(np.float32)
        return cls(shadows, single[0], np.asarray(rest), K, single[1], level.overdispersion)

    @property
    def freedom(self) -> int:
        """F, the pixels less the kinds of ambient light."""
        return int(len(self.photograph) - self.background.shape[1])

    @property
    def energy(self) -> Array:
        """(3,) ‖y⊥_c‖²."""
        return np.asarray(np.einsum("mc,mc->c", self.photograph, self.photograph))

    def matrix(self, opacities: Array) -> Single:
        """Return A⊥(m), (M, N), for opacities (K,)."""
        A = self.shadows.matrix(opacities).astype(np.float32)
        return self._projected(self.gain[:, None] * A)

    def best_ratio(self, opacities: Array, allowance: float) -> float:
        """Return the α of most evidence, images of any sign, for opacities (K,)."""
        A = self.matrix(opacities)
        μ, W = linalg.eigh((A.T @ A).astype(float), self.smoothness, check_finite=False)
        μ = np.maximum(μ, 0)
        squared = (W.T @ (A.T @ self.photograph)) ** 2
        # In units of K, which is of norm about 1.
        tried = RATIOS * μ.mean()
        whole = (1 + allowance) * self.energy

        def evidence(α: float) -> float:
            left = np.maximum(whole - (squared / (μ + α)[:, None]).sum(axis=0), LEAST * whole)
            return float(self.freedom * np.log(left).sum() + 3 * np.log1p(μ / α).sum())

        return float(tried[int(np.argmin([evidence(α) for α in tried]))])

    def at(
        self, opacities: Array, α: float, allowance: float, start: Array
    ) -> tuple[float, Array, Array]:
        """Return E, its gradient, (K,), and the images, (N, 3), for opacities (K,).

        The images are sought from those of `start`; they do not depend on it.
        """
        A = self.matrix(opacities)
        gram = (A.T @ A).astype(float)
        H = gram + α * self.smoothness
        correlation = (A.T @ self.photograph.astype(np.float32)).astype(float)
        factor = linalg.cholesky(H, lower=True, check_finite=False)
        volume = 2 * float(np.log(np.diag(factor)).sum()) - self._log_volume(α)
        images = np.column_stack(
            [nonnegative_fit(H, h, f) for h, f in zip(correlation.T, start.T, strict=True)]
        )
        whole = self.energy
        left = (1 + allowance) * whole - np.einsum("nc,nc->c", images, correlation)
        left = np.maximum(left, LEAST * whole)
        total = float(self.freedom * np.log(left / whole).sum()) + 3 * volume
        lower, _ = linalg.lapack.dpotri(factor, lower=1)
        inverse = (np.tril(lower) + np.tril(lower, -1).T).astype(np.float32)
        residuals = self.photograph - A @ images
        misfit = (self.freedom / left * residuals).astype(np.float32) @ images.T.astype(np.float32)
        gradient = self.gain[:, None] * self._projected(2 * (3 * A @ inverse - misfit))
        κ = self.overdispersion
        return total / κ, -self.shadows.along(gradient) / κ, images

    def _log_volume(self, α: float) -> float:
        """Return log |α K|."""
        return float(np.linalg.slogdet(self.smoothness)[1] + len(self.smoothness) * np.log(α))

    def _projected(self, light: Single) -> Single:
        """Return light, (M, N), with range(B) projected out."""
        return light - self.background @ (self.background.T @ light)
