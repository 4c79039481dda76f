"""FISTA for least squares with total variation, in Gram form.

    f̂ = argmin_f ‖K f − b‖₂² + λ‖f‖_TV = argmin_f fᵀG f − 2 hᵀf + λ‖f‖_TV,   G = KᵀK,  h = Kᵀb

The M rows of K are met only once, in G and h. From then on an iteration costs one product with
the N x N matrix G and one proximal operator of total variation.

`converge` solves the problem. Total variation does not see the mean of f, so that the mean is
solved for in closed form at every step. That matters: differences that wrap across the columns of
a photograph make the uniform image by far the largest singular vector of K. Without it the
Lipschitz constant is an eighth. The momentum is restarted whenever it points uphill, and a duality
gap tells when to stop. `descend_as_published` takes the steps of the published code of [15].

References
----------
Beck, Teboulle, "A fast iterative shrinkage-thresholding algorithm for linear inverse problems",
2009.
O'Donoghue, Candès, "Adaptive restart for accelerated gradient schemes", 2015.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass
from functools import cached_property

import numba
import numpy as np
from numpy.typing import NDArray
from scipy import linalg

from periscopy_sim.reconstruction.total_variation.prox import solve_total_variation, total_variation

Array = NDArray[np.float64]

FIRST_STEP = 1e-5
"""The first step of [15], for a data term ½‖K f − b‖²."""

STEP_SHRINKAGE, STEP_GROWTH = 0.3, 5.0
"""Factors on the step of [15] after a failed line search and after each iteration."""

SMALLEST_CHANGE = 2.4e-6
"""[15] stops at this spectral norm of the change of an image in [0, 1], divided by N."""

FEWEST_ITERATIONS, MOST_ITERATIONS = 10, 1100
"""[15] runs for more iterations than the one and for at most as many as the other."""

_GAP_INTERVAL = 20


@dataclass(frozen=True, eq=False)
class LeastSquares:
    """The quadratic ‖K f − b‖², for one K and any b.

    Attributes
    ----------
    gram
        (N, N) G = KᵀK.
    cholesky
        (N, N) upper triangular R with RᵀR = G.
    image_shape
        (R, C) of f, with product N.
    """

    gram: Array
    cholesky: Array
    image_shape: tuple[int, int]

    def product(self, f: Array) -> Array:
        """Multiply (N,) by G, on one thread: waking others takes longer, by far on a busy machine.

        Its result does not depend on the number of threads either.
        """
        return _product(self.gram, f)

    def solve(self, h: Array) -> Array:
        """Apply G⁻¹ to (N,) or (N, K): the unregularized least squares."""
        solution: Array = linalg.cho_solve((self.cholesky.T, True), h, check_finite=False)
        return solution

    @cached_property
    def uniform(self) -> Array:
        """(N,) G 1, the image of the uniform image."""
        image: Array = self.gram.sum(axis=1)
        return image

    def best_mean(self, residual: Array) -> Array:
        """Give what to add to the mean of f for the least ‖K f − b‖², from h − G f, (N,...)."""
        shift: Array = residual.sum(axis=0) / self.uniform.sum()
        return shift

    @cached_property
    def lipschitz(self) -> float:
        """Largest eigenvalue of G where the mean is solved for, G − G11ᵀG / 1ᵀG1."""
        g = self.uniform
        last = len(g) - 1
        eigenvalues = linalg.eigvalsh(
            self.gram - np.outer(g, g / g.sum()), subset_by_index=(last, last), check_finite=False
        )
        # A single patch is all mean, and leaves nothing.
        return max(float(eigenvalues[0]), np.finfo(np.float64).eps * float(np.trace(self.gram)))

    def gap(self, h: Array, weight: float, f: Array, gradient: Array) -> float:
        """Evaluate the duality gap at f, an upper bound on ‖K(f − f̂)‖².

        Every field q of length at most λ/2 bounds the minimum from below, by −uᵀG⁻¹u with
        u = h + div q. After a step of length s, f = z − s(G z − h) + s div q by the proximal
        operator's own dual field, so that u = G z + (f − z)/s costs nothing.

        Parameters
        ----------
        h, weight
            The problem.
        f
            (N,) image.
        gradient
            (N,) u − h, which is zero at the minimum of the quadratic.

        Returns
        -------
        float
            Not negative; rounding errors of the two bounds' difference remain.
        """
        primal = f @ self.product(f) - 2 * h @ f + weight * self._total_variation(f)
        u = h + gradient
        return max(float(primal + u @ self.solve(u)), 0.0)

    def denoised(self, f: Array, weight: float, tolerance: float) -> Array:
        """Apply the proximal operator of total variation to an (N,) image."""
        image = f.reshape(self.image_shape)
        return solve_total_variation(image, weight, tolerance=tolerance).image.ravel()

    def _total_variation(self, f: Array) -> float:
        return total_variation(f.reshape(self.image_shape))


@dataclass(frozen=True, eq=False)
class FistaResult:
    """Where an iteration ended.

    Attributes
    ----------
    f
        (N,) the image.
    iterations
        How many were taken.
    gap
        The duality gap as a fraction of ‖K f‖² of the unregularized f. ‖K(f − f̂)‖² is at most
        this fraction of it.
    """

    f: Array
    iterations: int
    gap: float


def converge(
    problem: LeastSquares, h: Array, weight: float, *, tolerance: float, max_iterations: int
) -> FistaResult:
    """Minimize fᵀG f − 2 hᵀf + λ‖f‖_TV to a relative duality gap.

    Parameters
    ----------
    problem
        The quadratic.
    h
        (N,) Kᵀb.
    weight
        λ ≥ 0.
    tolerance
        Relative duality gap at which to stop.
    max_iterations
        Where to stop otherwise.

    Returns
    -------
    FistaResult
    """
    g, L = problem.uniform, problem.lipschitz
    f = z = problem.solve(h)
    energy = float(h @ f)
    gap = math.inf
    t = 1.0
    iteration = 0
    while iteration < max_iterations and gap > tolerance * energy:
        iteration += 1
        residual = h - problem.product(z)
        gradient = g * problem.best_mean(residual) - residual
        previous, f = f, problem.denoised(z - gradient / L, weight / L, tolerance / 10)
        if iteration % _GAP_INTERVAL == 0 or iteration == max_iterations:
            centred = f + problem.best_mean(h - problem.product(f))
            gap = problem.gap(h, weight, centred, gradient + L * (f - z))
        t, momentum = _next_momentum(t)
        if (z - f) @ (f - previous) > 0:  # uphill
            t, momentum = 1.0, 0.0
        z = f + momentum * (f - previous)
    return FistaResult(
        f + problem.best_mean(h - problem.product(f)), iteration, gap / (energy or 1.0)
    )


def descend_as_published(
    problem: LeastSquares, h: Array, weight: float, *, unit: float, white: float
) -> FistaResult:
    """Take the steps of the published code of [15] until it stops.

    Accelerated proximal gradient steps from the unregularized least squares. The step may grow
    fivefold each time and is then shortened until the quadratic model, with the spectral norm of
    the step as an image, bounds the data term. After a growth the proximal operator keeps the
    weight of the shorter step, until the line search fails: this is how the published code has
    it, and why its image wanders about the minimum, by some 10 % and depending on rounding, until
    its iterations are used up. The proximal operator is solved to a relative duality gap of 1e-6,
    where the published code waits for a relative change of 1e-6.

    Parameters
    ----------
    problem
        The quadratic.
    h
        (N,) Kᵀb.
    weight
        λ ≥ 0; in [15], whose data term has one half, λ/2.
    unit
        What K has to be multiplied by to be in the units of [15], to which `FIRST_STEP` belongs.
    white
        The value of f which is 1 in [15], to which `SMALLEST_CHANGE` belongs.

    Returns
    -------
    FistaResult
    """
    f = z = problem.solve(h)
    energy = float(h @ f)
    t = 1.0
    step = FIRST_STEP * unit**2
    threshold = weight * step
    iteration, settled = 0, False
    while iteration < MOST_ITERATIONS and not settled:
        iteration += 1
        slope = problem.product(z) - h
        trial = problem.denoised(z - step * slope, threshold, 1e-6)
        while not _is_majorized(problem, trial - z, step):
            step *= STEP_SHRINKAGE
            threshold = weight * step
            trial = problem.denoised(z - step * slope, threshold, 1e-6)
        gradient = slope + (trial - z) / step
        change, f = trial - f, trial
        settled = iteration > FEWEST_ITERATIONS and (
            _spectral_norm(change, problem) <= SMALLEST_CHANGE * white * len(f)
        )
        t, momentum = _next_momentum(t)
        z = f + momentum * change
        step *= STEP_GROWTH
    return FistaResult(f, iteration, problem.gap(h, weight, f, gradient) / (energy or 1.0))


def _is_majorized(problem: LeastSquares, step_taken: Array, step: float) -> bool:
    """Tell whether ½‖K f − b‖² lies below its model with curvature 1/step; linear parts cancel."""
    curvature = float(step_taken @ problem.product(step_taken))
    return curvature <= _spectral_norm(step_taken, problem) ** 2 / step


def _spectral_norm(f: Array, problem: LeastSquares) -> float:
    image = f.reshape(problem.image_shape)
    return math.sqrt(max(float(np.linalg.eigvalsh(image @ image.T)[-1]), 0.0))


def _next_momentum(t: float) -> tuple[float, float]:
    """Advance FISTA's sequence t, and give the weight (t_k − 1) / t_{k+1} of the last change."""
    following = (1 + math.sqrt(1 + 4 * t * t)) / 2
    return following, (t - 1) / following


def _product_loop(G: Array, f: Array) -> Array:
    product = np.empty(len(f))
    for i in range(len(f)):
        total = 0.0
        for j in range(len(f)):
            total += G[i, j] * f[j]
        product[i] = total
    return product


# Sums may be reordered, so that the loop vectorizes.
_product: Callable[[Array, Array], Array] = numba.njit(
    cache=True, nogil=True, fastmath={"reassoc", "nsz", "contract"}
)(_product_loop)
