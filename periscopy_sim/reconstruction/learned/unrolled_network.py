"""An unrolled network: steps that explain the photograph, and steps that were learned.

Step k is

    x_k = argmin_x misfit(x) + ρ_k ‖x − v_{k−1}‖²_K,    ρ_k = r_k/e²
    v_k = v_{k−1} + D_k(x_k, v_{k−1}, v_0, log e_i)

the first of them a proximal step in closed form (`proximal_step`), the second a small convolutional
network of its own, after the scheme of J. Adler and O. Öktem, "Learned primal-dual reconstruction",
IEEE TMI 2018. v_0 is the noise-aware image, e_i the patches' standard errors under a Gaussian prior
of that image's contrast (`problem`) and e their root mean square. D_k ends in weights that are zero
before training, so that the network begins as v_0.
"""

from __future__ import annotations

from typing import Any

import torch
from torch import nn

from periscopy_sim.reconstruction.learned.proximal_step import (
    Problems,
    explained,
    log_level,
    mean_precision,
)

DILATIONS = 1, 2, 1, 1
"""Of the four layers of each D_k: with them a patch hears of those up to 5 away."""


class UnrolledNetwork(nn.Module):  # type: ignore[misc]  # PyTorch is not checked
    """The steps of the module; takes `Problems`, gives images, (K, 3, R, C)."""

    def __init__(self, steps: int = 8, width: int = 24) -> None:
        super().__init__()
        self.log_ratios = nn.Parameter(torch.linspace(0.0, 2.0, steps))  # log r_k
        self.learned = nn.ModuleList(_convolutions(width) for _ in range(steps))

    def forward(self, problems: Problems) -> torch.Tensor:
        """Return the images, (K, 3, R, C), over their scale."""
        start, logs = problems.start, log_level(problems.errors)
        precision = mean_precision(problems)
        v = start
        for log_ratio, learned in zip(self.log_ratios, self.learned, strict=True):
            x = explained(problems, v, log_ratio.exp() * precision)
            v = v + learned(torch.cat([x, v, start, logs], dim=1))
        return v


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
