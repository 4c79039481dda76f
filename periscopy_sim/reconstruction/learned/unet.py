"""A small U-Net that removes noise, told how strong it is, and its use after P.

The network is that of O. Ronneberger, P. Fischer and T. Brox, "U-Net: convolutional networks for
biomedical image segmentation", MICCAI 2015, in small: three scales, told the noise by a map of its
own (K. Zhang, W. Zuo and L. Zhang, "FFDNet", IEEE TIP 2018). After an inverse it is the
post-processing of K. H. Jin et al., "Deep convolutional neural network for inverse problems in
imaging", IEEE TIP 2017: here after P y, the paper's least squares free of ambient light.
"""

from __future__ import annotations

import torch
from torch import nn

from periscopy_sim.reconstruction.learned.proximal_step import Problems, explained, log_level


class UNet(nn.Module):  # type: ignore[misc]  # PyTorch is not checked
    """Take noisy images, (K, 3, R, C), and the logarithm of their noise, (K, 1, R, C)."""

    def __init__(self, width: int = 16) -> None:
        super().__init__()
        w = width
        self.fine = _two_layers(4, w)
        self.middle = _two_layers(w, 2 * w)
        self.coarse = _two_layers(2 * w, 4 * w)
        self.middle_again = _two_layers(6 * w, 2 * w)
        self.fine_again = _two_layers(3 * w, w)
        self.last = nn.Conv2d(w, 3, 3, padding=1)
        nn.init.zeros_(self.last.weight)
        nn.init.zeros_(self.last.bias)

    def forward(self, noisy: torch.Tensor, logs: torch.Tensor) -> torch.Tensor:
        """Return the images without their noise, (K, 3, R, C)."""
        fine = self.fine(torch.cat([noisy, logs], dim=1))
        middle = self.middle(_halved(fine))
        coarse = self.coarse(_halved(middle))
        middle = self.middle_again(torch.cat([_as_fine_as(middle, coarse), middle], dim=1))
        fine = self.fine_again(torch.cat([_as_fine_as(fine, middle), fine], dim=1))
        return noisy + self.last(fine)


class PostProcessing(nn.Module):  # type: ignore[misc]
    """A U-Net after P: takes `Problems`, gives images, (K, 3, R, C)."""

    def __init__(self, width: int = 16) -> None:
        super().__init__()
        self.unet = UNet(width)

    def forward(self, problems: Problems) -> torch.Tensor:
        """Return the images, over their scale."""
        return self.unet(least_squares(problems), log_level(problems.errors))


def least_squares(problems: Problems) -> torch.Tensor:
    """Return P y, (K, 3, R, C): what explains the photographs best, whatever its noise."""
    nothing = torch.zeros_like(problems.errors[:, 0, :1, :1])
    return explained(problems, problems.start, nothing)


def _two_layers(before: int, after: int) -> nn.Sequential:
    return nn.Sequential(
        nn.Conv2d(before, after, 3, padding=1),
        nn.ReLU(),
        nn.Conv2d(after, after, 3, padding=1),
        nn.ReLU(),
    )


def _halved(images: torch.Tensor) -> torch.Tensor:
    return nn.functional.avg_pool2d(images, 2, ceil_mode=True, count_include_pad=False)


def _as_fine_as(fine: torch.Tensor, coarse: torch.Tensor) -> torch.Tensor:
    return nn.functional.interpolate(coarse, fine.shape[2:], mode="bilinear", align_corners=False)
