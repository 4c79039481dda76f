"""An unrolled network: steps that explain the photograph, and steps that were learned.

In the spectral basis of a scene (`spectral_basis`), step k is

    x_k = argmin_x Σ_p w_p ‖a_p − λ_p x_p‖²/λ_p + ρ_k ‖x − v_{k−1}‖²_K,    ρ_k = r_k/e²
    v_k = v_{k−1} + D_k(x_k, v_{k−1}, v_0, log e_i)

the first of them a proximal step of the misfit in closed form, a_p the photograph's coefficients,
w_p what each weighs, K = ∇ᵀ∇ + I; the second a small convolutional network of its own, after the
scheme of J. Adler and O. Öktem, "Learned primal-dual reconstruction", IEEE TMI 2018. v_0 is the
noise-aware image, e_i the patches' standard errors under a Gaussian prior of that image's contrast
(`problem`) and e their root mean square. D_k ends in weights that are zero before training, so that
the network begins as v_0.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import torch
from torch import nn

STEPS = 8
WIDTH = 24
DILATIONS = 1, 2, 1, 1
"""Of the four layers of each D_k: with them a patch hears of those up to 5 away."""


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
        (K, 1, R, C) standard errors e_i.
    start
        (K, 3, R, C) v_0.
    """

    rows: torch.Tensor
    curvatures: torch.Tensor
    rows_K: torch.Tensor
    axes: torch.Tensor
    data: torch.Tensor
    weights: torch.Tensor
    errors: torch.Tensor
    start: torch.Tensor


class UnrolledNetwork(nn.Module):  # type: ignore[misc]  # PyTorch is not checked
    """The steps of the module; takes `Problems`, gives images, (K, 3, R, C)."""

    def __init__(self, steps: int = STEPS, width: int = WIDTH) -> None:
        super().__init__()
        self.log_ratios = nn.Parameter(torch.linspace(0.0, 2.0, steps))  # log r_k
        self.learned = nn.ModuleList(_convolutions(width) for _ in range(steps))

    def forward(self, problems: Problems) -> torch.Tensor:
        """Return the images, (K, 3, R, C), over their scale."""
        start, errors = problems.start, problems.errors
        logs = torch.log10(errors) + 2
        precision = errors.square().mean(dim=(1, 2, 3)).reciprocal()[:, None, None]
        v = start
        for log_ratio, learned in zip(self.log_ratios, self.learned, strict=True):
            x = explained(problems, v, log_ratio.exp() * precision)
            v = v + learned(torch.cat([x, v, start, logs], dim=1))
        return v


def explained(problems: Problems, v: torch.Tensor, ρ: torch.Tensor) -> torch.Tensor:
    """Return x of the module, (K, 3, R, C), near images v; ρ is (K, 1, 1)."""
    pulled = problems.axes @ (v.flatten(2) @ problems.rows_K.T)
    coefficients = problems.data + ρ * pulled
    coefficients = coefficients / (problems.weights * problems.curvatures + ρ)
    return (problems.axes.mT @ (coefficients @ problems.rows)).reshape(v.shape)


def _convolutions(width: int) -> Any:
    channels = (10, width, width, width, 3)
    layers: list[nn.Module] = []
    for before, after, dilation in zip(channels[:-1], channels[1:], DILATIONS, strict=True):
        layers += [
            nn.Conv2d(before, after, 3, padding=dilation, dilation=dilation),
            nn.ReLU(),
        ]
    layers.pop()  # no positive part at the end
    last = layers[-1]
    assert isinstance(last, nn.Conv2d) and last.bias is not None
    nn.init.zeros_(last.weight)
    nn.init.zeros_(last.bias)
    return nn.Sequential(*layers)
