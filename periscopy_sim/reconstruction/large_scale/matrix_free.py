"""Least squares with and without total variation, where A can only be passed over.

    f̂ = argmin_f ‖W (A⊥ f − y⊥)‖₂² + λ‖f‖_TV

One iteration of either method is one pass over A for all columns of y together. What makes these
iterations many is the range of A⊥'s singular values. Its k strongest singular vectors are few and
cheap to find, once for a scene (`TransportOperator.strongest_eigenvectors`). With them

- conjugate gradients start from the least squares among these k;
- W = I − U (I − s Σ⁻¹) Uᵀ, with U and Σ the k strongest and s the least of them, lets no direction
  of the photograph weigh more than the k-th. P, which is W with all the singular values equal,
  would let noise weigh as much as signal. The k are measured so well that they lose nothing.

References
----------
Hestenes, Stiefel, "Methods of conjugate gradients for solving linear systems", 1952.
Golub, Heath, Wahba, "Generalized cross-validation as a method for choosing a good ridge
parameter", 1979.
Beck, Teboulle, "A fast iterative shrinkage-thresholding algorithm for linear inverse problems",
2009.
O'Donoghue, Candès, "Adaptive restart for accelerated gradient schemes", 2015.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from periscopy_sim.reconstruction.large_scale.transport_operator import (
    Eigenvectors,
    TransportOperator,
)
from periscopy_sim.reconstruction.total_variation.prox import solve_total_variation

Array = NDArray[np.float64]
Image = NDArray[np.floating[Any]]

SETTLING = 10
"""Iterations over which the estimate of the noise must have settled."""


@dataclass(frozen=True, eq=False)
class LeastSquaresIterate:
    """Where conjugate gradients ended.

    Attributes
    ----------
    f
        (N, K) the iterate.
    h
        (N, K) A⊥ᵀy⊥.
    iterations
        Passes over A, beside one for h.
    noise
        (K,) estimated standard deviation of the noise of y, see `least_squares`.
    misfit
        (K,) ‖y⊥ − A⊥f‖².
    gradient
        (K,) norm of A⊥ᵀ(y⊥ − A⊥f), relative to that of h.
    """

    f: Array
    h: Array
    iterations: int
    noise: Array
    misfit: Array
    gradient: Array


def least_squares(
    transport: TransportOperator,
    y: Image,
    *,
    tolerance: float = 1e-10,
    settled: float | None = None,
    max_iterations: int = 10_000,
    eigenvectors: Eigenvectors | None = None,
) -> LeastSquaresIterate:
    """Minimize ‖A⊥f − y⊥‖² by conjugate gradients on the normal equations.

    Each column is a problem of its own; all share the passes. After k iterations the estimate of
    the noise's variance is ‖y⊥ − A⊥f‖² / (M − r − k), with the number of eigenvectors added to k:
    so many degrees of freedom the iterate has, as in generalized cross-validation, where it divides
    once more by them. What the first iterations find is the signal. As soon as the estimate has
    settled, they would find noise.

    Parameters
    ----------
    transport
        A⊥.
    y
        (M, K) photographs.
    tolerance
        Stop when the gradient's norm is at most this part of the first one's.
    settled
        Stop also when the noise estimate fell by less than this part in `SETTLING` iterations;
        None does not. This is what regularizes.
    max_iterations
        Stop after so many.
    eigenvectors
        Eigenvectors of A⊥ᵀA⊥ to start from; None starts from f = 0.

    Returns
    -------
    LeastSquaresIterate
    """
    rejected = transport.reject_background(y)
    h: Array = transport.rmatmat(rejected)
    first = np.sum(h**2, axis=0)
    f, descent = np.zeros_like(h), h.copy()
    freedom = len(rejected) - transport.Q.shape[1]
    if eigenvectors is not None:
        f = eigenvectors.V @ ((eigenvectors.V.T @ h) / eigenvectors.energy[:, None])
        descent = h - transport.gram_product(f)
        freedom -= len(eigenvectors.energy)
    direction = descent.copy()
    slope = np.sum(descent**2, axis=0)
    misfit = np.sum(rejected**2, axis=0) - np.sum(f * (h + descent), axis=0)
    noise = [np.sqrt(np.maximum(misfit, 0) / max(freedom, 1))]
    while (
        len(noise) <= max_iterations
        and (slope > tolerance**2 * first).any()
        and not (settled is not None and _has_settled(noise, settled))
    ):
        image = transport.gram_product(direction)
        step = _ratio(slope, np.sum(direction * image, axis=0))
        f += step * direction
        descent -= step * image
        misfit = misfit - step * slope
        previous, slope = slope, np.sum(descent**2, axis=0)
        direction = descent + _ratio(slope, previous) * direction
        noise.append(np.sqrt(np.maximum(misfit, 0) / max(freedom - len(noise), 1)))
    return LeastSquaresIterate(
        f, h, len(noise) - 1, noise[-1], misfit, np.sqrt(_ratio(slope, first))
    )


def _has_settled(noise: list[Array], settled: float) -> bool:
    return len(noise) > SETTLING and bool((noise[-1] >= (1 - settled) * noise[-1 - SETTLING]).all())


def _ratio(a: Array, b: Array) -> Array:
    """Divide; 0 where both are: a black channel, or one that has converged to the last bit."""
    return np.divide(a, b, out=np.zeros_like(a), where=b > 0)


@dataclass(frozen=True, eq=False)
class TotalVariationIterate:
    """Where the accelerated proximal gradient method ended.

    Attributes
    ----------
    f
        (N, K) the iterate.
    descent
        (K,) ‖A⊥f − y⊥‖² − ‖y⊥‖².
    iterations
        Passes over A, beside one for the start.
    change
        The last proximal gradient step's norm as a part of f's, the largest of the columns; 0 at
        the minimum.
    """

    f: Array
    descent: Array
    iterations: int
    change: float


def total_variation_least_squares(
    transport: TransportOperator,
    eigenvectors: Eigenvectors,
    h: Array,
    weight: Array,
    start: Array,
    *,
    image_shape: tuple[int, int],
    tolerance: float,
    max_iterations: int,
) -> TotalVariationIterate:
    """Minimize ‖W(A⊥f − y⊥)‖² + λ‖f‖_TV by FISTA, its momentum restarted where it points uphill.

    Each column has its own λ and momentum; all share the passes.

    Parameters
    ----------
    transport
        A⊥.
    eigenvectors
        The k strongest eigenvectors of A⊥ᵀA⊥, to whose last all weigh down.
    h
        (N, K) A⊥ᵀy⊥.
    weight
        (K,) λ.
    start
        (N, K) first iterate.
    image_shape
        (R, C) of a column of f, with product N.
    tolerance
        Stop when `TotalVariationIterate.change` is at most this.
    max_iterations
        Stop after so many.

    Returns
    -------
    TotalVariationIterate
    """
    V, energy = eigenvectors.V, eigenvectors.energy[:, None]
    least = energy[-1]
    L = 1.01 * float(least[0])  # the eigenvectors are known to a tolerance

    def weighed_product(f: Array) -> Array:
        """A⊥ᵀWᵀW A⊥ f."""
        product: Array = transport.gram_product(f) - V @ ((energy - least) * (V.T @ f))
        return product

    weighed = h - V @ ((1 - least / energy) * (V.T @ h))  # A⊥ᵀWᵀW y⊥
    f, Gf = start, weighed_product(start)
    z, Gz = f, Gf
    t = np.ones(h.shape[1])
    iterations, change = 0, np.inf
    while iterations < max_iterations and change > tolerance:
        iterations += 1
        previous, G_previous = f, Gf
        image = (z - (Gz - weighed) / L).reshape(*image_shape, -1)
        denoised = solve_total_variation(image, weight / L, tolerance=tolerance / 10).image
        f = np.asarray(denoised, np.float64).reshape(h.shape)
        # The product with z follows from those with f by linearity: one pass an iteration.
        Gf = weighed_product(f)
        change = float(_ratio(np.linalg.norm(f - z, axis=0), np.linalg.norm(f, axis=0)).max())
        uphill = np.sum((z - f) * (f - previous), axis=0) > 0
        following = (1 + np.sqrt(1 + 4 * t**2)) / 2
        momentum = np.where(uphill, 0.0, (t - 1) / following)
        t = np.where(uphill, 1.0, following)
        z = f + momentum * (f - previous)
        Gz = Gf + momentum * (Gf - G_previous)
    unweighed = Gf + V @ ((energy - least) * (V.T @ f))
    return TotalVariationIterate(f, np.sum(f * (unweighed - 2 * h), axis=0), iterations, change)
