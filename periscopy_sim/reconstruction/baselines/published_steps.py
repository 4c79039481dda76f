"""The steps of the published code of [15] for least squares with total variation.

References
----------
[15] Saunders, Murray-Bruce, Goyal, "Computational periscopy with an ordinary digital camera",
Nature, 2019.
Beck, Teboulle, "A fast iterative shrinkage-thresholding algorithm for linear inverse problems",
2009.
"""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import NDArray

from periscopy_sim.reconstruction.total_variation.least_squares import (
    LeastSquares,
    LeastSquaresMinimum,
)
from periscopy_sim.reconstruction.total_variation.prox import solve_total_variation

Array = NDArray[np.float64]

FIRST_STEP = 1e-5
"""The first step of [15], for a data term ½‖K f − b‖²."""

STEP_SHRINKAGE, STEP_GROWTH = 0.3, 5.0
"""Factors on the step of [15] after a failed line search and after each iteration."""

SMALLEST_CHANGE = 2.4e-6
"""[15] stops at this spectral norm of the change of an image in [0, 1], divided by N."""

FEWEST_ITERATIONS, MOST_ITERATIONS = 10, 1100
"""[15] runs for more iterations than the one and for at most as many as the other."""


def descend_as_published(
    problem: LeastSquares, h: Array, weight: float, *, unit: float, white: float
) -> LeastSquaresMinimum:
    """Take the steps of the published code of [15] until it stops; h is Kᵀb, (N,).

    Accelerated proximal gradient steps from the unregularized least squares. The step may grow
    fivefold each time and is then shortened until the quadratic model, with the spectral norm of
    the step as an image, bounds the data term. After a growth the proximal operator keeps the
    weight of the shorter step, until the line search fails: this is how the published code has it,
    and why its image wanders about the minimum, by some 10 % and depending on rounding, until its
    iterations are used up. The proximal operator is solved to a relative duality gap of 1e-6, where
    the published code waits for a relative change of 1e-6.

    The weight is λ ≥ 0, in [15], whose data term has one half, λ/2. `unit` takes K to the units of
    [15], to which `FIRST_STEP` belongs; `white` is the f that is 1 there, as for `SMALLEST_CHANGE`.
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
        trial = _denoised(problem, z - step * slope, threshold, 1e-6)
        while not _is_majorized(problem, trial - z, step):
            step *= STEP_SHRINKAGE
            threshold = weight * step
            trial = _denoised(problem, z - step * slope, threshold, 1e-6)
        divergence = slope + (trial - z) / step
        change, f = trial - f, trial
        settled = iteration > FEWEST_ITERATIONS and (
            _spectral_norm(change, problem) <= SMALLEST_CHANGE * white * len(f)
        )
        following = (1 + math.sqrt(1 + 4 * t * t)) / 2
        z = f + (t - 1) / following * change
        t = following
        step *= STEP_GROWTH
    gap = problem.gap(h, weight, f, divergence)
    return LeastSquaresMinimum(f, iteration, gap / (energy or 1.0))


def _is_majorized(problem: LeastSquares, step_taken: Array, step: float) -> bool:
    """Return whether ½‖K f − b‖² lies below its model with curvature 1/step."""
    # The linear parts cancel.
    curvature = float(step_taken @ problem.product(step_taken))
    return curvature <= _spectral_norm(step_taken, problem) ** 2 / step


def _spectral_norm(f: Array, problem: LeastSquares) -> float:
    image = f.reshape(problem.image_shape)
    return math.sqrt(max(float(np.linalg.eigvalsh(image @ image.T)[-1]), 0.0))


def _denoised(problem: LeastSquares, f: Array, weight: float, tolerance: float) -> Array:
    image = f.reshape(problem.image_shape)
    return solve_total_variation(image, weight, tolerance=tolerance).image.ravel()
