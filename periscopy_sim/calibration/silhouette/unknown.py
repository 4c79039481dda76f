"""The mask behind which an unknown image makes a photograph: descents from random masks.

    E(A) = Σ_c F log(S_c + τ ‖y⊥_c‖²) + 3 log |A⊥ᵀA⊥ + α K| / |α K|
    S_c = min ‖y⊥_c − A⊥ f‖² + α fᵀ K f  over f ≥ 0

The photograph is bilinear in mask and image: a blind deconvolution, whose kernel is the mask. As
Levin et al. (IEEE TPAMI 33, 2011) advise for that, the image is integrated out while the mask is
estimated. The constraint f ≥ 0 rules out most wrong masks: without it a wrong mask
explains a photograph nearly as well. α is fixed while opacities move. The allowance τ is a fraction
of the photograph that need not be explained yet: the larger, the smoother is E.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace

import numpy as np
from scipy import linalg
from scipy.ndimage import gaussian_filter, zoom
from scipy.optimize import nnls
from scipy.special import ndtr

from periscopy_sim.calibration.evidence import ROUNDING, Matrix, SmoothImages
from periscopy_sim.calibration.silhouette.mask import (
    Explained,
    Mask,
    MaskFit,
    opaque,
    usual_opacity,
)
from periscopy_sim.numerics import Array

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


def search(
    coarse: tuple[Mask, UnknownImage],
    fine: tuple[Mask, UnknownImage],
    seed: int,
    report: Callable[[float], None],
) -> tuple[MaskFit, int]:
    """Return the best mask, and how many of the starts ended near it."""
    random, ends, fits = np.random.default_rng(seed), [], []
    for k in range(STARTS):
        # A few smooth pieces: rougher starts end at small dots before an image of their shadow.
        rough = random.standard_normal(coarse[0].cells)
        noise = gaussian_filter(rough, SMOOTH * np.array(rough.shape), mode="reflect")
        opacities = ndtr((noise - noise.mean()) / max(float(noise.std()), 1e-300))
        ends.append(_descend(*coarse, opacities, np.zeros(len(coarse[0].terms)), ALLOWANCES))
        report(0.3 * (k + 1) / STARTS)
    ends.sort(key=lambda end: end.objective)
    cells = fine[0].cells
    for k, end in enumerate(ends[:FINALISTS]):
        start = np.minimum(resized(end.opacities / usual_opacity(end.opacities), cells), 1.0)
        fits.append(_descend(*fine, start, end.gain, ALLOWANCES[1:]))
        report(0.3 + 0.7 * (k + 1) / FINALISTS)
    best = min(fits, key=lambda fit: fit.objective)
    ours, masks = opaque(best.opacities), [opaque(resized(end.opacities, cells)) for end in ends]
    return best, sum(bool((ours & m).sum() >= AGREEING * (ours | m).sum()) for m in masks)


def _descend(
    mask: Mask, image: UnknownImage, opacities: Array, gain: Array, allowances: Sequence[float]
) -> MaskFit:
    for allowance in allowances:
        likelihood = image.at(mask.transport(opacities, gain), allowance)
        fit = mask.descend(opacities, gain, likelihood, STEPS)
        opacities, gain = fit.opacities, fit.gain
    return mask.fit(opacities, gain, image.at(mask.transport(opacities, gain), 0.0))


def resized(opacities: Array, cells: tuple[int, int]) -> Array:
    """Return opacities on a grid of other cells, (rows, columns): those of the nearest ones."""
    factors = np.divide(cells, opacities.shape)
    return np.asarray(zoom(opacities, factors, order=0, grid_mode=True, mode="nearest"))
