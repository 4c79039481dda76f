"""Photographs as learned methods see them, and the step that explains them, in closed form.

In the spectral basis of a scene (`spectral_basis`) the photograph's own part of every learned
method is a proximal step of the misfit,

    x = argmin_x Σ_p w_p ‖a_p − λ_p x_p‖²/λ_p + ρ ‖x − v‖²_K,    K = ∇ᵀ∇ + I

with a_p the photograph's coefficients and w_p what each weighs.
"""

from __future__ import annotations

from dataclasses import dataclass

import torch


@dataclass(frozen=True, eq=False)
class Problems:
    """What is known of K photographs of one scene; images are over their scale, near 1.

    Attributes
    ----------
    rows, curvatures
        (N, N) the scene's patterns W_p, one a row, and (N,) their λ_p.
    rows_K
        (N, N) W_p K, a pattern a row.
    axes
        (K, 3, 3) orthonormal axes of colour along which the noise is independent, an axis a row.
    data, weights
        (K, 3, N) w a and w, along the axes.
    errors
        (K, 1, R, C) standard errors of the patches under a Gaussian prior; see `problem`.
    start
        (K, 3, R, C) the noise-aware images.
    """

    rows: torch.Tensor
    curvatures: torch.Tensor
    rows_K: torch.Tensor
    axes: torch.Tensor
    data: torch.Tensor
    weights: torch.Tensor
    errors: torch.Tensor
    start: torch.Tensor


def explained(problems: Problems, v: torch.Tensor, ρ: torch.Tensor) -> torch.Tensor:
    """Return x of the module, (K, 3, R, C), near images v; ρ is (K, 1, 1)."""
    pulled = problems.axes @ (v.flatten(2) @ problems.rows_K.T)
    coefficients = problems.data + ρ * pulled
    coefficients = coefficients / (problems.weights * problems.curvatures + ρ)
    return (problems.axes.mT @ (coefficients @ problems.rows)).reshape(v.shape)


def mean_precision(problems: Problems) -> torch.Tensor:
    """Return the reciprocal mean square of the patches' standard errors, (K, 1, 1)."""
    return problems.errors.square().mean(dim=(1, 2, 3)).reciprocal()[:, None, None]


def log_level(errors: torch.Tensor) -> torch.Tensor:
    """Return errors or noise levels as networks take them: about 0 to 2."""
    return torch.log10(errors) + 2
