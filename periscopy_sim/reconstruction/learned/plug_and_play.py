"""Plug and play: a denoiser in the place of a prior, in turns with the step that explains.

    x_k = argmin_x misfit(x) + ρ_k ‖x − v_{k−1}‖²_K,    ρ_k = r/σ_k²
    v_k = D(x_k, σ_k)

after S. Venkatakrishnan, C. Bouman and B. Wohlberg, "Plug-and-play priors for model based
reconstruction", GlobalSIP 2013. The levels σ_k fall evenly in their logarithm as in K. Zhang et
al., "Plug-and-play image restoration with deep denoiser prior", IEEE TPAMI 2022: from `widest` to
`last` times the patches' mean standard error. v_0 is the noise-aware image. The penalty is in the
norm of K, so that D is to remove Gaussian noise of covariance σ² K⁻¹, not white noise
(`inverse_root`): it is the MAP estimate's own splitting.
"""

from __future__ import annotations

import torch
from torch import nn

from periscopy_sim.reconstruction.learned.proximal_step import (
    Problems,
    explained,
    log_level,
    mean_precision,
)
from periscopy_sim.reconstruction.learned.unet import UNet


class PlugAndPlay(nn.Module):  # type: ignore[misc]  # PyTorch is not checked
    """The turns of the module; takes `Problems`, gives images, (K, 3, R, C)."""

    def __init__(self, steps: int = 8, width: int = 16) -> None:
        super().__init__()
        self.steps = steps
        self.unet = UNet(width)
        # Chosen on validation images once D is trained; kept with its weights.
        for name, value in (("log_ratio", -1.5), ("log_widest", -1.0), ("log_last", -1.0)):
            self.register_buffer(name, torch.tensor(value))

    def forward(self, problems: Problems) -> torch.Tensor:
        """Return the images, over their scale."""
        last = self.log_last.exp() * mean_precision(problems).rsqrt()
        first = torch.maximum(self.log_widest.exp(), last)
        v = problems.start
        for share in torch.linspace(0, 1, self.steps):
            σ = first ** (1 - share) * last**share
            x = explained(problems, v, self.log_ratio.exp() / σ.square())
            v = self.unet(x, level_map(σ, x))
        return v


def level_map(σ: torch.Tensor, images: torch.Tensor) -> torch.Tensor:
    """Return (K, 1, R, C) logarithms of noise levels, (K, 1, 1), as the U-Net takes them."""
    return log_level(σ)[..., None].expand(-1, 1, *images.shape[2:])


def inverse_root(K: torch.Tensor) -> torch.Tensor:
    """Return K^(-1/2), (N, N): times it, white noise, (..., N), has the covariance K⁻¹."""
    values, vectors = torch.linalg.eigh(K)
    return (vectors * values.rsqrt()) @ vectors.T
