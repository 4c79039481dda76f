"""Rules for the weight λ of the total variation, all tried on one grid of weights.

Each weight is solved for twice: with the data as they are, and with a little noise added, of the
covariance that the photograph's has. From the change follows the divergence of the estimate, its
effective degrees of freedom (Ramani, Blu and Unser 2008, Sec. III).
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy import linalg

from experiments.beyond.normal_equations import Measured, NormalEquations
from experiments.beyond.regularizers import Regularized

Array = NDArray[np.float64]
Choices = NDArray[np.signedinteger[Any]]
"""Places in the grid of weights, (P,)."""

STEP = 0.3
"""Size of the added noise over σ: far above what the solver leaves, far below what is nonlinear."""


@dataclass(frozen=True, eq=False)
class Trials:
    """Photographs recovered at each of W weights.

    Attributes
    ----------
    weights
        (W,) relative weights, see `Measured.problem`.
    images
        (W, N, P, 3).
    misfit
        Σ_c ‖A⊥f_c − y⊥_c‖²/σ_c², (W, P).
    freedom
        Effective degrees of freedom of the three channels, (W, P).
    pixels
        What the misfit of the true image is on average.
    """

    weights: Array
    images: Array
    misfit: Array
    freedom: Array
    pixels: int


def trials(
    solver: Regularized,
    equations: NormalEquations,
    measured: Measured,
    weights: Sequence[float],
    seed: int,
) -> Trials:
    """Recover photographs at every weight."""
    # A⊥ᵀ times white noise has the covariance G: a Cholesky factor of it gives as much.
    N, stills, _ = measured.data.shape
    factor = linalg.cholesky(equations.gram + 1e-12 * np.eye(N), lower=True)
    white = np.random.default_rng(seed).standard_normal(measured.data.shape)
    σ = measured.noise
    added = STEP * σ * np.einsum("ij,jpc->ipc", factor, white)
    twice = Measured(
        np.concatenate([measured.data, measured.data + added], axis=1),
        np.tile(measured.energy, (2, 1)),
        np.tile(σ, (2, 1)),
    )
    images, misfit, freedom = [], [], []
    for weight in weights:
        found, moved = np.split(solver.minimize(twice.problem(weight)), [stills], axis=1)
        images.append(found)
        misfit.append(np.sum(equations.misfit(measured, found) / σ**2, axis=1))
        freedom.append(np.sum(added * (moved - found) / (STEP * σ) ** 2, axis=(0, 2)))
    return Trials(
        np.asarray(weights),
        np.stack(images),
        np.stack(misfit),
        np.stack(freedom),
        3 * equations.pixels,
    )


def discrepancy(found: Trials) -> Choices:
    """Choose the weight whose misfit is that of the true image (Morozov)."""
    return np.asarray(np.argmin(np.abs(found.misfit - found.pixels), axis=0))


def compensated_discrepancy(found: Trials) -> Choices:
    """Choose the weight whose misfit is what the degrees of freedom leave."""
    return np.asarray(np.argmin(np.abs(found.misfit - (found.pixels - found.freedom)), axis=0))


def unbiased_risk(found: Trials) -> Choices:
    """Minimize Stein's unbiased estimate of the error of A⊥f (SURE)."""
    return np.asarray(np.argmin(found.misfit + 2 * found.freedom, axis=0))


def cross_validation(found: Trials) -> Choices:
    """Minimize the generalized cross-validation score, which needs no σ but its ratios."""
    return np.asarray(np.argmin(found.misfit / (1 - found.freedom / found.pixels) ** 2, axis=0))


Rule = Callable[[Trials], Choices]

RULES: dict[str, tuple[Rule, int]] = {
    "discrepancy, misfit = n": (discrepancy, 1),
    "discrepancy, misfit = n − df": (compensated_discrepancy, 2),
    "SURE": (unbiased_risk, 2),
    "generalized cross-validation": (cross_validation, 2),
}
"""Each rule and the solves that it needs for each weight tried."""
