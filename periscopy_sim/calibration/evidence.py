"""How well a transport matrix explains a photograph, whatever the hidden image and ambient light.

    y_c = A f_c + B b_c + n_c,   f_c ~ N(0, σ_c²/α_c K⁻¹),   n_c ~ N(0, σ_c² I),   b_c free

K prefers smooth hidden images, see `image_precision`. All but A is eliminated (variable projection:
Golub and Pereyra, SIAM J. Numer. Anal. 10, 1973), the image by integration (the evidence: MacKay,
Neural Comput. 4, 1992): a best fit alone would favour the A that bends to any photograph. One
number remains for each channel,

    E_c = F log S_c + Σ log(1 + μ/α_c),   S_c = ‖y⊥‖² − Σ z_c²/(μ + α_c) = F σ_c²,

twice the negative logarithm of the evidence up to a constant. F is M less the rank of B, μ and W
are the generalized eigenvalues and vectors of (A⊥ᵀA⊥, K), z = Wᵀ A⊥ᵀ y⊥, and ⊥ projects range(B)
out. Each α_c minimizes E_c. The mean image is f̂ = W z/(μ + α).

Errors that neighbours share (paint, bounced light, a misplaced scene) are not white. A filter makes
them white first, see `whitening`. If their slopes still vary κ times as much as those of white
noise (`Curvature.overdispersion`), the evidence is divided by κ, beside the prior of the parameters
(a composite likelihood adjusted in magnitude: Ribatet, Cooley and Davison, Statistica Sinica 22,
2012).
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from functools import cached_property
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy import linalg
from scipy.optimize import minimize_scalar

Array = NDArray[np.float64]
Matrix = NDArray[np.floating[Any]]
Filter = Callable[[Matrix], Matrix]

BRIGHTNESS = 0.01
"""ε: weight of how bright an image is, beside how rough."""

RATIOS = np.geomspace(1e-10, 1e2, 25)
"""Values of α that are tried, over the mean energy of a patch, before the best is refined."""

ROUNDING = 1e-7
"""Of single precision, in which A is computed."""

LEAST = 1e-14
"""Fraction of the photograph's energy below which a misfit is rounding."""


def image_precision(shape: tuple[int, int]) -> Array:
    """Return K for images of (R, C) patches, (R C, R C), row-major.

    fᵀ K f = Σ (difference of neighbours)² + ε ‖f‖². Beyond the monitor all is dark: else an
    image moved until it touches the border would be smoother than one that does not, and the
    evidence would favour a place whole patches from the right one.
    """
    down, across = (_differences(size) for size in shape)
    K: Array = np.kron(down, np.eye(shape[1])) + np.kron(np.eye(shape[0]), across)
    K[np.diag_indices_from(K)] += BRIGHTNESS
    return K


def _differences(size: int) -> Array:
    """Return the squared differences' matrix, (size, size), of a row of patches in the dark."""
    differences = np.diff(np.eye(size + 2)[:, 1:-1], axis=0)
    return differences.T @ differences


@dataclass(frozen=True, eq=False)
class Explanation:
    """A photograph explained by a transport matrix, by a hidden image and ambient light.

    Attributes
    ----------
    evidence
        Σ E_c, over κ, and the prior's penalty where a level adds it: a difference of 2 is a
        likelihood ratio of e. Less is better.
    darkness
        The evidence of a black hidden image. Where the evidence is less, the photograph shows one.
    noise
        (3,) σ_c of the residual.
    images
        (N, 3) the most probable hidden image, f̂.
    residual
        (M, 3) y⊥ − A⊥ f̂, as the filter leaves it.
    freedom
        F.
    overdispersion
        κ.
    """

    evidence: float
    darkness: float
    noise: Array
    images: Array
    residual: Array
    freedom: int
    overdispersion: float
    _filter: Filter | None
    _projected: Array  # (M, N) A⊥
    _background: Array  # (M, r) orthonormal basis of range(B)
    _modes: tuple[Array, Array]  # μ (N,), W (N, N)
    _ratios: Array  # (3,) α_c

    @property
    def deviations(self) -> Array:
        """(3,) σ_c κ^½: of white noise that tells as much as the errors do."""
        return np.asarray(self.noise * np.sqrt(self.overdispersion))

    @property
    def unexplained(self) -> float:
        """Fraction of y⊥, root mean square, that stays unexplained."""
        photograph = self.residual + self._projected @ self.images
        return float(np.linalg.norm(self.residual) / np.linalg.norm(photograph))

    @property
    def darker_than_black(self) -> float:
        """Fraction of the hidden image's light, in absolute value, that is negative."""
        return float(np.maximum(-self.images, 0).sum() / (np.abs(self.images).sum() or 1.0))

    @cached_property
    def volume(self) -> NDArray[np.float32]:
        """(M, N) derivative of Σ_c Σ log(1 + μ/α_c) / 2 by the entries of A."""
        μ, W = self._modes
        weights = (1 / (μ[:, None] + self._ratios)).sum(axis=1)
        volume = ((self._projected @ W) * weights) @ W.T
        return np.asarray(self._filtered(volume), np.float32)  # the filter is symmetric

    def _filtered(self, light: Matrix) -> Matrix:
        return light if self._filter is None else self._filter(light)

    def motion(self, light: Matrix) -> Array:
        """Return how the photograph moves with more light on the wall, (M, 3): over σ κ^½."""
        return self.without_background(np.asarray(self._filtered(light))) / self.deviations

    def slope(self, motion: Array, volume: float) -> float:
        """Return the derivative of half the evidence along a change dA of the matrix, (M, N).

        dE/2 = Σ_c (−r_cᵀ dA f̂_c / σ_c² + ⟨A⊥ (A⊥ᵀA⊥ + α_c K)⁻¹, dA⟩) / κ, α_c fixed. `motion` is
        that of the light dA f̂, and `volume` is ⟨self.volume, dA⟩.
        """
        misfit = np.einsum("mc,mc,c->", self.residual, motion, 1 / self.deviations)
        return float(volume / self.overdispersion - misfit)

    @property
    def gradient(self) -> Array:
        """(M, N) derivatives of the evidence by each entry of the matrix."""
        errors = self._filtered(self.residual / self.deviations**2)
        return np.asarray(2 * (self.volume / self.overdispersion - errors @ self.images.T))

    def without_background(self, light: Array) -> Array:
        """Return light, (..., M, 3), with range(B) projected out."""
        return np.asarray(light - self._background @ (self._background.T @ light))

    def beyond_image(self, motion: Array) -> Array:
        """Return what no hidden image can follow of motions, (P, M, 3).

        J̃ = J⊥ − A⊥ H⁻¹ A⊥ᵀ J⊥, H = A⊥ᵀA⊥ + α K. The information on two parameters is the product
        of one's J̃ and the other's `motion`.
        """
        (μ, W), beyond = self._modes, np.empty_like(motion)
        for c, α in enumerate(self._ratios):
            J = motion[:, :, c].T
            modes = (W.T @ (self._projected.T @ J)) / (μ + α)[:, None]
            beyond[:, :, c] = (J - self._projected @ (W @ modes)).T
        return beyond

    def residual_of(self, errors: Array) -> Array:
        """Return what image and light would leave of small errors, (M, 3)."""
        return np.asarray(self.beyond_image(self.without_background(errors)[None])[0])


def explain(
    A: Matrix,
    background: Array,
    y: Array,
    hidden_shape: tuple[int, int],
    whitening: Filter | None = None,
    overdispersion: float = 1.0,
) -> Explanation:
    """Explain a photograph y, (M, 3) of any unit, by a transport matrix A, (M, N), N = R C.

    The background is an orthonormal basis of range(B), (M, r). A, B and y pass the symmetric filter
    `whitening` first.
    """
    Q, free = background, 0.0
    if whitening is not None:
        A, y = whitening(A), np.asarray(whitening(y), np.float64)
        Q, root = np.linalg.qr(whitening(Q))
        # The spread of the free light must not count by what the filter makes of it.
        free = 6 * float(np.log(np.abs(np.diag(root))).sum())
    projected = Q @ -(Q.T @ A)
    projected += A
    rest = y - Q @ (Q.T @ y)
    gram = projected.T @ projected
    unit = np.trace(gram) / len(gram) or 1.0  # of darkness, which explains nothing
    μ, W = linalg.eigh(gram / unit, image_precision(hidden_shape), check_finite=False)
    μ, W = np.maximum(μ, 0) * unit, W
    z = W.T @ (projected.T @ rest)
    freedom = len(y) - Q.shape[1]
    # A photograph without noise still has finite precision.
    energy = np.einsum("mc,mc->c", rest, rest) + freedom * ROUNDING**2 * float(np.mean(y**2))
    best = [_best_ratio(μ / unit, z[:, c] ** 2 / unit, float(energy[c]), freedom) for c in range(3)]
    ratios = unit * np.array([α for α, _ in best])
    images = W @ (z / (μ[:, None] + ratios))
    misfit = energy - (z**2 / (μ[:, None] + ratios)).sum(axis=0)
    κ = overdispersion
    return Explanation(
        evidence=(sum(E for _, E in best) + free) / κ,
        darkness=(float(freedom * np.log(energy[energy > 0]).sum()) + free) / κ,
        noise=np.sqrt(np.maximum(misfit, LEAST * energy.max()) / freedom),
        images=images,
        residual=rest - projected @ images,
        freedom=freedom,
        overdispersion=κ,
        _filter=whitening,
        _projected=projected,
        _background=Q,
        _modes=(μ, W),
        _ratios=ratios,
    )


def _best_ratio(μ: Array, squares: Array, energy: float, freedom: int) -> tuple[float, float]:
    """Return the α at which a channel's E_c is least, and E_c there."""

    def evidence(log_ratio: float) -> float:
        α = np.exp(log_ratio)
        left = max(energy - float((squares / (μ + α)).sum()), LEAST * energy)
        return float(freedom * np.log(left) + np.log1p(μ / α).sum())

    if not energy > 0:
        return 1.0, 0.0
    tried = np.log(RATIOS)
    least = int(np.argmin([evidence(value) for value in tried]))
    bounds = tried[max(least - 1, 0)], tried[min(least + 1, len(tried) - 1)]
    found = minimize_scalar(evidence, bounds=bounds, method="bounded")
    return float(np.exp(found.x)), float(found.fun)
