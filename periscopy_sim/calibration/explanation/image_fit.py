"""A photograph explained by a hidden image and ambient light, all else left being white noise.

What the image follows of any change of the photograph is known then, too: near it image and light
are linear. See `evidence`, of which these are the equations for one gain and white errors.
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

from periscopy_sim.calibration.explanation.image_prior import image_precision
from periscopy_sim.calibration.explanation.ridge_path import RidgePath, inverse

Array = NDArray[np.float64]
Filter = Callable[[NDArray[np.floating[Any]]], NDArray[np.floating[Any]]]

RATIOS = np.geomspace(1e-10, 1e2, 25)
"""Values of α that are tried, over the mean energy of a patch, before the best is refined."""

ROUNDING = 1e-7
"""Of single precision, in which A is rendered."""

LEAST = 1e-14
"""Of the photograph's energy: below it is rounding, not misfit."""

LEAST_LEFT = 0.01
"""Part of an error that must be left in the residuals to be raised to the whole of it."""

PATIENCE = 3
"""Exchanges of all patches on the wrong side that may fail to lessen their number."""


@dataclass(frozen=True, eq=False)
class ImageFit:
    """The most probable hidden image, and what image and light can follow.

    Light and errors are as a symmetric filter, `whitening`, leaves them.
    """

    images: Array  # (N, 3) the most probable hidden image, f̂
    evidence: float  # Σ E_c
    darkness: float  # the same of a black hidden image
    noise: Array  # (3,) σ_c, of what is left unexplained
    residuals: Array  # (M, 3) y⊥ − A⊥ f̂
    freedom: int  # F
    whitening: Filter | None
    _projected: Array
    _background: Array
    _hessians: tuple[Array, ...]
    _nonnegative: bool

    @property
    def light(self) -> Array:
        """(M, 3) A⊥ f̂, what is explained by the image."""
        return self.shown(self.images)

    def shown(self, images: Array) -> Array:
        """Return the light of hidden images, (N, 3): A⊥ f, (M, 3)."""
        return np.asarray(self._projected @ images)

    @cached_property
    def volume(self) -> Array:
        """(M, N) A⊥ Σ_c (A⊥ᵀA⊥ + α_c K)⁻¹, the derivative of half the volume Σ log(1 + μ/α)."""
        by_patch = self._projected @ np.sum([inverse(H) for H in self._hessians], axis=0)
        # The filter is symmetric.
        return np.asarray(self.whitened(by_patch), np.float32)

    def whitened(self, errors: Array) -> Array:
        """Return errors, (..., M, K), as white as they get."""
        if self.whitening is None:
            return errors
        if errors.ndim > 2:
            return np.array([self.whitened(each) for each in errors])
        return np.asarray(self.whitening(errors))

    def without_background(self, light: Array) -> Array:
        """Return light, (..., M, 3), with range(B) projected out."""
        return np.asarray(light - self._background @ (self._background.T @ light))

    @cached_property
    def _following(self) -> list[tuple[NDArray[np.bool_], tuple[Array, bool]]]:
        """Which patches of each channel follow a change, and the Cholesky factor of H there.

        All do, unless images are kept from shining negatively: then those that shine.
        """
        shine = (self.images > 0).T if self._nonnegative else np.ones_like(self.images.T, bool)
        return [
            (on, linalg.cho_factor(H[np.ix_(on, on)], check_finite=False))
            for on, H in zip(shine, self._hessians, strict=True)
        ]

    def information(self, moved: Array) -> Array:
        """Return the Fisher information, (K, K), on how much of some moves, (K, M, 3), there is.

        They are as `moved` returns them. What image and light could follow tells nothing.
        """
        total = np.zeros((len(moved), len(moved)))
        for c, (on, factor) in enumerate(self._following):
            J = moved[:, :, c].T
            followed = _halfway(factor, self._projected[:, on].T @ J)
            total += J.T @ J - followed.T @ followed
        return total

    def beyond_image(self, moved: Array) -> Array:
        """Return what hidden images leave of light, (..., M, 3), without a part in range(B)."""
        light = moved.reshape(-1, *moved.shape[-2:])
        beyond = np.empty_like(light)
        for c, (on, factor) in enumerate(self._following):
            J = light[:, :, c].T
            response = np.zeros((len(self.images), len(light)))
            response[on] = linalg.cho_solve(factor, (self._projected.T @ J)[on], check_finite=False)
            beyond[:, :, c] = (J - self._projected @ response).T
        return beyond.reshape(moved.shape)

    def left_of_rows(self, rows: Array) -> Array:
        """Return what any image and light would leave of rows, (J, M), each taken as green."""
        errors = self.without_background(rows.T)
        response = linalg.solve(
            self._hessians[1], self._projected.T @ errors, assume_a="pos", check_finite=False
        )
        return np.asarray((errors - self._projected @ response).T)

    def unabsorbed(self, pixels: NDArray[np.intp], errors: Array) -> Array:
        """Return errors left at some pixels, (m, 3), raised by what was absorbed of them.

        Of white errors image and light leave (I − L)^½, L = Q Qᵀ + A⊥ H⁻¹ A⊥ᵀ at these pixels, H as
        in `Explanation.projected`. This undoes it ("CR2": Bell and McCaffrey, Surv.
        Methodol. 28, 2002).
        """
        raised, light = np.empty_like(errors), self._background[pixels]
        for c, (on, factor) in enumerate(self._following):
            followed = _halfway(factor, self._projected[np.ix_(pixels, on)].T)
            leverage = light @ light.T + followed.T @ followed
            left, directions = np.linalg.eigh(np.eye(len(pixels)) - leverage)
            whole = (directions.T @ errors[:, c]) / np.sqrt(np.maximum(left, LEAST_LEFT))
            raised[:, c] = directions @ whole
        return raised


def fit_image(
    A: NDArray[np.floating[Any]],
    background: Array,
    y: Array,
    hidden_shape: tuple[int, int],
    whitening: Filter | None = None,
    nonnegative: bool = False,
) -> ImageFit:
    """Fit image and light to a photograph y, (M, 3) of any unit, by a matrix A, (M, N), N = R C.

    The background is an orthonormal basis of range(B), (M, r). All are as a symmetric filter,
    `whitening`, leaves them, A as it comes. Images that are `nonnegative` shine so where they fit
    best; the volume is that of images of any sign all the same.
    """
    Q = background
    if whitening is not None:
        A = whitening(A)
    projected = Q @ -(Q.T @ A)
    projected += A
    rest = y - Q @ (Q.T @ y)
    K = image_precision(hidden_shape)
    gram = projected.T @ projected
    unit = np.trace(gram) / len(gram) or 1.0  # of darkness, which explains nothing
    correlation = projected.T @ rest
    path = RidgePath.of(gram / unit, K, correlation / np.sqrt(unit))
    freedom = len(y) - Q.shape[1]
    # Without noise there still is finite precision.
    energy = np.einsum("mc,mc->c", rest, rest) + freedom * ROUNDING**2 * float(np.mean(y**2))
    evidence, misfit = 0.0, np.empty(3)
    images, hessians = np.empty_like(correlation), []
    for c in range(3):
        ratio, value = _best_ratio(path, c, float(energy[c]), freedom)
        hessians.append(gram + ratio * unit * K)
        images[:, c] = path.fit(ratio, c) / np.sqrt(unit)
        misfit[c] = max(energy[c] - float(images[:, c] @ correlation[:, c]), LEAST * energy.max())
        evidence += value
        if nonnegative:
            images[:, c] = nonnegative_fit(hessians[c], correlation[:, c], images[:, c])
            least, misfit[c] = misfit[c], energy[c] - float(images[:, c] @ correlation[:, c])
            evidence += freedom * np.log(max(misfit[c] / least, 1.0)) if least > 0 else 0.0
    return ImageFit(
        images=images,
        evidence=evidence,
        darkness=float(freedom * np.log(energy[energy > 0]).sum()),
        noise=np.sqrt(misfit / freedom),
        residuals=rest - projected @ images,
        freedom=freedom,
        whitening=whitening,
        _projected=projected,
        _background=Q,
        _hessians=tuple(hessians),
        _nonnegative=nonnegative,
    )


def _halfway(factor: tuple[Array, bool], h: Array) -> Array:
    """Return x, (N, J), whose xᵀx is hᵀH⁻¹h, from the Cholesky factor of H, (N, N)."""
    root, lower = factor
    return np.asarray(
        linalg.solve_triangular(root, h, trans=int(not lower), lower=lower, check_finite=False)
    )


def nonnegative_fit(H: Array, h: Array, start: Array) -> Array:
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
            factor = linalg.cho_factor(
                H[np.ix_(positive, positive)], overwrite_a=True, check_finite=False
            )
            f[positive] = linalg.cho_solve(factor, h[positive], check_finite=False)
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


def _best_ratio(path: RidgePath, c: int, energy: float, freedom: float) -> tuple[float, float]:
    """Return the α at which a channel's E_c is least, and E_c there."""

    def evidence(log_ratio: float) -> float:
        volume, explained = path.volume_and_explained(float(np.exp(log_ratio)), c)
        return float(freedom * np.log(max(energy - explained, LEAST * energy)) + volume)

    if not energy > 0:
        return 1.0, 0.0
    tried = np.log(RATIOS)
    least = int(np.argmin([evidence(value) for value in tried]))
    bounds = tried[max(least - 1, 0)], tried[min(least + 1, len(tried) - 1)]
    found = minimize_scalar(evidence, bounds=bounds, method="bounded")
    return float(np.exp(found.x)), float(found.fun)
