"""An unrolled network: steps that explain the photograph, and steps that were learned.

In the spectral basis of a scene (`spectral_basis`) step k is

    x_k = argmin_x Σ_p w_p ‖a_p − λ_p x_p‖²/λ_p + ρ_k ‖x − v_{k−1}‖²_K,    ρ_k = r_k/e²
    v_k = v_{k−1} + D_k(x_k, v_{k−1}, v_0, log e_i)

with K = ∇ᵀ∇ + I, a_p the photograph's coefficients and w_p their weights. The first line is a
proximal step of the misfit in closed form. In the second, D_k is a small convolutional network of
the step, after the scheme of J. Adler and O. Öktem, "Learned primal-dual reconstruction", IEEE TMI
2018. v_0 is the noise-aware image, e_i are the patches' standard errors under a Gaussian prior of
that image's contrast (`Problem`), and e is their root mean square. D_k ends in weights that are
zero before training, so that the network begins as v_0.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import torch
from torch import nn

CHANNELS = 3
"""Channels of the images that networks learn from."""

DILATIONS = 1, 2, 1, 1
"""Dilations of the four layers of each D_k: a patch depends on neighbours up to 5 away."""


@dataclass(frozen=True, eq=False)
class Problems:
    """K photographs of one scene as the network reads them; images are over their scale, near 1."""

    rows: torch.Tensor  # (N, N) the scene's patterns W_p, one a row
    curvatures: torch.Tensor  # (N,) their λ_p
    rows_K: torch.Tensor  # (N, N) W_p K, a pattern a row
    data: torch.Tensor  # (K, 3, N) w a
    weights: torch.Tensor  # (K, 3, N) w
    errors: torch.Tensor  # (K, 1, R, C) standard errors of the patches; see `Problem`
    start: torch.Tensor  # (K, 3, R, C) the noise-aware images


class UnrolledNetwork(nn.Module):  # type: ignore[misc]  # PyTorch is not checked
    """The network of the module: it maps `Problems` to images, (K, 3, R, C)."""

    def __init__(self, steps: int = 8, width: int = 24) -> None:
        super().__init__()
        self.log_ratios = nn.Parameter(torch.linspace(0.0, 2.0, steps))  # log r_k
        self.learned = nn.ModuleList(_convolutions(width) for _ in range(steps))

    def forward(self, problems: Problems) -> torch.Tensor:
        """Return the images, (K, 3, R, C), over their scale."""
        start = problems.start
        logs = torch.log10(problems.errors) + 2  # about 0 to 2
        precision = problems.errors.square().mean(dim=(1, 2, 3)).reciprocal()[:, None, None]
        v = start
        for log_ratio, learned in zip(self.log_ratios, self.learned, strict=True):
            x = proximal_step(problems, v, log_ratio.exp() * precision)
            v = v + learned(torch.cat([x, v, start, logs], dim=1))
        return v


def proximal_step(problems: Problems, v: torch.Tensor, ρ: torch.Tensor) -> torch.Tensor:
    """Return x of the module, (K, 3, R, C), near images v; ρ is (K, 1, 1)."""
    coefficients = problems.data + ρ * (v.flatten(2) @ problems.rows_K.T)
    coefficients = coefficients / (problems.weights * problems.curvatures + ρ)
    return (coefficients @ problems.rows).reshape(v.shape)


def _convolutions(width: int) -> Any:
    channels = (3 * CHANNELS + 1, width, width, width, CHANNELS)
    layers: list[nn.Module] = []
    for before, after, dilation in zip(channels[:-1], channels[1:], DILATIONS, strict=True):
        layers += [nn.Conv2d(before, after, 3, padding=dilation, dilation=dilation), nn.ReLU()]
    layers.pop()  # the last layer's values may be negative
    last = layers[-1]
    assert isinstance(last, nn.Conv2d) and last.bias is not None
    nn.init.zeros_(last.weight)
    nn.init.zeros_(last.bias)
    return nn.Sequential(*layers)
