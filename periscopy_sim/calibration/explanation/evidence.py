"""How well a transport matrix explains a photograph, whatever the hidden image and ambient light.

    y_c = A f_c + B b_c + n_c,   f_c ~ N(0, σ_c²/α_c K⁻¹),   n_c ~ N(0, σ_c² I),   b_c free

K = ∇ᵀ∇ + ε I says that hidden images are smooth rather than not. Everything but A is eliminated
(variable projection: Golub and Pereyra, SIAM J. Numer. Anal. 10, 1973), the image not at its best
fit but by integration (the evidence: MacKay, Neural Comput. 4, 1992): a best fit alone would favour
the A that bends to any photograph. What is left is one number for a channel,

    E_c = F log S_c + Σ log(1 + μ/α_c),   S_c = ‖y⊥‖² − Σ z_c²/(μ + α_c) = F σ_c²,

twice the negative logarithm of the evidence but for a constant; F is M less the rank of B, μ and W
are the generalized eigenvalues and vectors of (A⊥ᵀA⊥, K), z = Wᵀ A⊥ᵀ y⊥, ⊥ stands for range(B)
projected out. Each α_c is where E_c is least.

That is so where errors n are white. Errors that neighbours share, of paint, bounced light or a
misplaced scene, are strong at some scales. There y, A and B are divided by how strong, see
`discrepancy`, which makes what is left white. If its slopes still vary κ times as much as those of
white errors (`Curvature.overdispersion`), the evidence counts for 1/κ of that, beside the prior of
the parameters (a composite likelihood adjusted in magnitude: Ribatet, Cooley and Davison,
Statistica Sinica 22, 2012).

Nothing shines negatively. S_c is the least of ‖y⊥ − A⊥ f‖² + α_c fᵀK f, and is then taken over
f ≥ 0, with the α_c from before. A scene that is wrong needs negative light to explain a photograph
more often than a right one; without this the wrong one may win.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, field, replace
from functools import cached_property
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy import linalg
from scipy.optimize import minimize_scalar

from periscopy_sim.calibration.explanation.smooth_gain import SmoothGain
from periscopy_sim.reconstruction.noise_aware.spectral_basis import laplacian
from periscopy_sim.reconstruction.noise_aware.wall_gain import SPREAD

Array = NDArray[np.float64]
Filter = Callable[[NDArray[np.floating[Any]]], NDArray[np.floating[Any]]]

ROUGHNESS = 0.01
"""ε: all that the prior says of how bright an image is, as against how rough."""

RATIOS = np.geomspace(1e-8, 1e2, 21)
"""Values of α that are tried, over the mean energy of a patch, before the best is refined."""

ROUNDING = 1e-7
"""Of single precision, in which A is rendered."""

LEAST = 1e-14
"""Of the photograph's energy: below it is rounding, not misfit."""

LEAST_LEFT = 0.01
"""Part of an error that must be left in the residuals to be raised to the whole of it."""

LEAST_VARIANCE = 1e-6
"""Part of the residuals' energy that a gain leaves at least."""

PATIENCE = 3
"""Exchanges of all patches on the wrong side that may fail to lessen their number."""


@dataclass(frozen=True, eq=False)
class Explanation:
    """A photograph explained by a transport matrix.

    The evidence is Σ E_c: a difference of 2 is a likelihood ratio of e. `darkness` is what it would
    be of a black hidden image: where the evidence is less, the photograph shows one. A `gain` over
    the wall, see `SmoothGain`, multiplies A.
    """

    evidence: float
    darkness: float
    images: Array  # (N, 3) the most probable hidden image, f̂ ≥ 0
    noise: Array  # (3,) σ_c, of what is left unexplained
    overdispersion: float  # κ, by which each error counts for less
    residuals: Array  # (M, 3) y⊥ − A⊥ f̂
    freedom: int  # F
    _projected: Array
    _background: Array
    _weights: Array
    _W: Array
    _hessians: tuple[Array, ...]
    whitening: Filter | None = None  # of errors, before all else
    gain: SmoothGain | None = None
    # How the photograph moves with the gain, beyond images, over σ κ^½, and the gain's covariance.
    gain_terms: Array = field(default_factory=lambda: np.zeros((0, 0, 3)))  # (K, M, 3)
    gain_covariance: Array = field(default_factory=lambda: np.zeros((0, 0)))  # (K, K)

    @property
    def deviations(self) -> Array:
        """(3,) σ_c κ^½: of white noise that tells as much as the errors do."""
        return np.asarray(self.noise * np.sqrt(self.overdispersion))

    @property
    def left(self) -> float:
        """Part of y⊥, root mean square, that is left unexplained."""
        whole = self.residuals + self._projected @ self.images
        return float(np.linalg.norm(self.residuals) / np.linalg.norm(whole))

    @cached_property
    def _volume(self) -> Array:
        """(M, N) g A⊥ Σ_c (A⊥ᵀA⊥ + α_c K)⁻¹, the derivative of half the volume Σ log(1 + μ/α)."""
        inverse = (self._W * self._weights.sum(axis=1)) @ self._W.T
        # The filter is symmetric.
        found = self._gained(self._whitened(self._projected @ inverse))
        return np.asarray(found, np.float32)

    def _gained(self, light: NDArray[np.floating[Any]]) -> Array:
        """Return light, (M, ...), as the gain makes it."""
        return np.asarray(light if self.gain is None else self.gain.field[:, None] * light)

    def _whitened(self, errors: Array) -> Array:
        """Return errors, (..., M, K), as white as they get."""
        if self.whitening is None:
            return errors
        if errors.ndim > 2:
            return np.array([self._whitened(each) for each in errors])
        return np.asarray(self.whitening(errors))

    def without_background(self, light: Array) -> Array:
        """Return light, (..., M, 3), with range(B) projected out."""
        return np.asarray(light - self._background @ (self._background.T @ light))

    @cached_property
    def _positive(self) -> list[tuple[NDArray[np.bool_], tuple[Array, bool]]]:
        """Where f̂ > 0 in each channel, and the Cholesky factor of H there."""
        positive = [image > 0 for image in self.images.T]
        return [
            (on, linalg.cho_factor(H[np.ix_(on, on)], check_finite=False))
            for on, H in zip(positive, self._hessians, strict=True)
        ]

    def slope(self, change: NDArray[np.floating[Any]]) -> float:
        """Return the derivative of the evidence along a change dA of the matrix, (M, N).

        dE = Σ_c (−2 r_cᵀ dA f̂_c / σ_c² + 2 ⟨A⊥ (A⊥ᵀA⊥ + α_c K)⁻¹, dA⟩) / κ, the α_c held; r and A⊥
        have no part in range(B), so dA's own does not matter.
        """
        moved = self._whitened(self._gained(change @ self.images.astype(change.dtype)))
        misfit = np.einsum("mc,mc,c->", self.residuals, moved, self.deviations**-2)
        return float(2 * (np.vdot(self._volume, change) / self.overdispersion - misfit))

    @property
    def gradient(self) -> Array:
        """(M, N) the derivatives of the evidence by each entry of the matrix, see `slope`."""
        errors = self._gained(self._whitened(self.residuals / self.deviations**2))
        misfit = errors @ self.images.T
        return np.asarray(2 * (self._volume / self.overdispersion - misfit))

    def jacobian(self, change: NDArray[np.floating[Any]]) -> Array:
        """Return how the photograph moves along dA, J = dA f̂: J⊥ / (σ κ^½), (M, 3)."""
        return self.moved(change @ self.images.astype(change.dtype))

    def moved(self, light: NDArray[np.floating[Any]]) -> Array:
        """Return how the photograph moves with more light on the wall, (..., M, 3): over σ κ^½."""
        whitened = self._whitened(self._gained(light))
        return np.asarray(self.without_background(whitened) / self.deviations)

    def information(self, moved: Array) -> Array:
        """Return the Fisher information, (K, K), on how much of some moves, (K, M, 3), there is.

        They are as `moved` returns them. What image and light could follow tells nothing.
        """
        total = np.zeros((len(moved), len(moved)))
        for c, (positive, (factor, lower)) in enumerate(self._positive):
            J = moved[:, :, c].T
            followed = linalg.solve_triangular(
                factor, self._projected[:, positive].T @ J, trans=0 if lower else 1, lower=lower,
                check_finite=False,
            )  # fmt: skip
            total += J.T @ J - followed.T @ followed
        return total

    def projected_jacobian(self, change: NDArray[np.floating[Any]]) -> Array:
        """Return how it moves along dA, beyond what image, light and gain could follow.

        (M, 3) J̃ = J⊥ − A⊥ H⁻¹ A⊥ᵀ J⊥ over σ κ^½, H = A⊥ᵀA⊥ + αK of the patches where f̂ > 0, and of
        that what no gain could follow. The information on two parameters is the product of one's J̃
        and the other's `jacobian`.
        """
        return self._beyond_gain(self.jacobian(change))

    def left_of(self, errors: Array) -> Array:
        """Return what image, light and gain would leave of small errors, (M, 3), over σ κ^½."""
        return self._beyond_gain(self.without_background(errors))

    def left_of_rows(self, rows: Array) -> Array:
        """Return what any image and light would leave of rows, (J, M), each taken as green."""
        errors = self.without_background(rows.T)
        response = linalg.solve(
            self._hessians[1], self._projected.T @ errors, assume_a="pos", check_finite=False
        )
        return np.asarray((errors - self._projected @ response).T)

    def _beyond_gain(self, moved: Array) -> Array:
        beyond = self.beyond_image(moved)
        if not len(self.gain_terms):
            return beyond
        pull = np.einsum("kmc,mc->k", self.gain_terms, moved, optimize=True)
        by_gain = np.einsum(
            "k,kmc->mc", self.gain_covariance @ pull, self.gain_terms, optimize=True
        )
        return np.asarray(beyond - by_gain)

    def beyond_image(self, moved: Array) -> Array:
        """Return what hidden images leave of light, (M, 3), that range(B) is projected out of."""
        response = np.zeros_like(self.images)
        for c, (positive, factor) in enumerate(self._positive):
            response[positive, c] = linalg.cho_solve(
                factor, (self._projected.T @ moved[:, c])[positive], check_finite=False
            )
        return np.asarray(moved - self._projected @ response)

    def with_gain(self, near: SmoothGain, A: NDArray[np.floating[Any]]) -> Explanation:
        """Return what explains the photograph with the best gain near one, see `SmoothGain`.

        This one must explain it by `near.field` times A, (M, N). The images stay f̂, as derivatives
        do: where the gain has moved far, explain it again by that gain.
        """
        if not (self.noise > 0).all():
            return self
        light = self._whitened(near.terms[:, :, None] * (A @ self.images))
        terms = self.without_background(light) / self.deviations
        beyond = np.array([self.beyond_image(term) for term in terms])
        residuals = self.residuals / self.deviations
        by_channel = np.einsum("jmc,kmc->cjk", beyond, terms, optimize=True)
        pull = np.einsum("kmc,mc->ck", terms, residuals)
        precision = np.eye(len(terms)) / SPREAD**2
        H = by_channel.sum(axis=0) + precision
        # A gain that dims what is known well would else pass for a simpler scene.
        volume = near.terms @ np.einsum("mn,mn->m", self._volume, A) / self.overdispersion
        q = pull.sum(axis=0) - volume - precision @ near.coefficients
        best = near.moved(np.linalg.solve(H, q))
        change = best.coefficients - near.coefficients
        # Both over σ_c² κ: what a channel's least squares are less by.
        gained = 2 * pull @ change - np.einsum("cjk,j,k->c", by_channel, change, change)
        left = np.maximum(1 - gained * self.overdispersion / self.freedom, LEAST_VARIANCE)
        followed = np.einsum("k,kmc->mc", change, beyond, optimize=True) * self.deviations
        return replace(
            self,
            evidence=self.evidence
            + float(self.freedom * np.log(left).sum()) / self.overdispersion
            + 2 * float(volume @ change)
            + best.penalty,
            noise=self.noise * np.sqrt(left),
            residuals=self.residuals - followed,
            gain=best,
            gain_terms=beyond / np.sqrt(left),
            gain_covariance=np.linalg.inv(
                (by_channel / left[:, None, None]).sum(axis=0) + precision
            ),
        )

    def shift(self, hidden_shape: tuple[int, int], axis: int) -> Array:
        """Return how the photograph moves as the hidden image does, by a patch down (0) or right.

        A⊥ (S f̂ − f̂) over σ κ^½, (M, 3), in the unit of `jacobian`; what enters is black.
        """
        image = self.images.reshape(*hidden_shape, 3)
        moved = np.roll(image, 1, axis)
        moved[(slice(None),) * axis + (0,)] = 0
        return np.asarray(self._projected @ (moved - image).reshape(-1, 3) / self.deviations)

    def unabsorbed(self, pixels: NDArray[np.intp]) -> Array:
        """Return residuals over σ κ^½ at some pixels, (m, 3), raised by what was absorbed of them.

        Of white errors image and light leave (I − L)^½, L = Q Qᵀ + A⊥ H⁻¹ A⊥ᵀ at these pixels, H as
        in `projected_jacobian`. This undoes it ("CR2": Bell and McCaffrey, Surv. Methodol. 28,
        2002).
        """
        errors = self.residuals[pixels] / self.deviations
        light = self._background[pixels]
        for c, (positive, factor) in enumerate(self._positive):
            image = self._projected[np.ix_(pixels, positive)]
            leverage = light @ light.T + image @ linalg.cho_solve(
                factor, image.T, check_finite=False
            )
            left, directions = np.linalg.eigh(np.eye(len(pixels)) - leverage)
            raised = (directions.T @ errors[:, c]) / np.sqrt(np.maximum(left, LEAST_LEFT))
            errors[:, c] = directions @ raised
        return errors


def explain(
    A: NDArray[np.floating[Any]],
    background: Array,
    y: Array,
    hidden_shape: tuple[int, int],
    overdispersion: float = 1.0,
    whitening: Filter | None = None,
) -> Explanation:
    """Explain a photograph y, (M, 3) of any unit, by a transport matrix A, (M, N), with N = R C.

    The background is an orthonormal basis of range(B), (M, r), the overdispersion κ, 1 of white
    errors. All are as a symmetric filter, `whitening`, leaves them, A as it comes.
    """
    Q = background
    if whitening is not None:
        A = whitening(A)
    projected = A - Q @ (Q.T @ A)
    rest = y - Q @ (Q.T @ y)
    K = laplacian(hidden_shape)
    K[np.diag_indices_from(K)] += ROUGHNESS - 1
    gram = projected.T @ projected
    unit = np.trace(gram) / len(gram)
    μ, W = linalg.eigh(gram / unit, K, check_finite=False)
    μ, W = np.maximum(μ, 0), W / np.sqrt(unit)
    z = W.T @ (projected.T @ rest)
    freedom = len(y) - Q.shape[1]
    # Without noise there still is finite precision.
    energy = np.einsum("mc,mc->c", rest, rest) + freedom * ROUNDING**2 * float(np.mean(y**2))
    evidence, ratios, misfit = 0.0, np.empty(3), np.empty(3)
    images, hessians = np.empty_like(z), []
    for c in range(3):
        ratios[c], value = _best_ratio(μ, z[:, c] ** 2, float(energy[c]), freedom)
        free = W @ (z[:, c] / (μ + ratios[c]))
        hessians.append(gram + ratios[c] * unit * K)
        correlation = projected.T @ rest[:, c]
        images[:, c] = nonnegative(hessians[c], correlation, free)
        least, attained = (
            max(energy[c] - float(f @ correlation), LEAST * energy.max())
            for f in (free, images[:, c])
        )
        evidence += value + (freedom * np.log(attained / least) if least > 0 else 0.0)
        misfit[c] = attained
    return Explanation(
        evidence=evidence / overdispersion,
        darkness=float(freedom * np.log(energy[energy > 0]).sum()) / overdispersion,
        images=images,
        noise=np.sqrt(misfit / freedom),
        overdispersion=overdispersion,
        residuals=rest - projected @ images,
        whitening=whitening,
        freedom=freedom,
        _projected=projected,
        _background=Q,
        _weights=1 / (μ[:, None] + ratios),
        _W=W,
        _hessians=tuple(hessians),
    )


def nonnegative(H: Array, h: Array, start: Array) -> Array:
    """Minimize fᵀHf/2 − hᵀf over f ≥ 0, (N,), exactly, for a positive definite H.

    Block principal pivoting (Kim and Park, SIAM J. Sci. Comput. 33, 2011): all patches on the wrong
    side change sides at once, while that helps; else the last of them alone. The positive entries
    of `start`, (N,), are tried first.
    """
    positive = start > 0
    fewest, patience = len(h) + 1, PATIENCE
    tolerance = 1e-12 * float(np.abs(h).max())
    while True:
        f = np.zeros_like(h)
        if positive.any():
            f[positive] = linalg.solve(
                H[np.ix_(positive, positive)], h[positive], assume_a="pos", check_finite=False
            )
        wrong = (f < 0) | (~positive & (H @ f - h < -tolerance))
        count = int(wrong.sum())
        if count == 0:
            return f
        if count < fewest:
            fewest, patience = count, PATIENCE
        elif patience > 0:
            patience -= 1
        else:
            wrong[: np.flatnonzero(wrong)[-1]] = False
        positive ^= wrong


def _best_ratio(μ: Array, squared: Array, energy: float, freedom: float) -> tuple[float, float]:
    """Return the α at which a channel's E_c is least, and E_c there."""

    def evidence(log_ratio: float) -> float:
        α = np.exp(log_ratio)
        misfit = max(energy - float(np.sum(squared / (μ + α))), LEAST * energy)
        return float(freedom * np.log(misfit) + np.log1p(μ / α).sum())

    if not energy > 0:
        return 1.0, 0.0
    tried = np.log(RATIOS)
    least = int(np.argmin([evidence(value) for value in tried]))
    bounds = tried[max(least - 1, 0)], tried[min(least + 1, len(tried) - 1)]
    found = minimize_scalar(evidence, bounds=bounds, method="bounded")
    return float(np.exp(found.x)), float(found.fun)
