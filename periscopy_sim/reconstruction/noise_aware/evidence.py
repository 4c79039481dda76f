"""Evidence of a hidden image in a photograph: its noise and its signal."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
from array_api_compat import array_namespace
from numpy.typing import NDArray

Array = NDArray[np.float64]

LARGEST_RATIO = 30
"""Between the noises of two channels: one that has less is not believed."""


@dataclass(frozen=True, eq=False)
class CommonNoise:
    """Noise that the channels share; see `common_noise`."""

    axes: Array  # (3, 3) orthonormal axes of colour, a row each, the noisiest first
    variances: Array  # (3, N') v, along them, of each coefficient over its curvature's root
    part: float  # s, above 0 and up to 1, to which the channels share it
    factor: float = 1.0  # on λ

    def weights(self, σ: float) -> Array:
        """Return (3, N') the weights (σ²/v)^(p/2) of the misfit, p = 2 − s."""
        return np.asarray((σ**2 / self.variances) ** (1 - self.part / 2))


@dataclass(frozen=True, eq=False)
class Evidence:
    """All that the objective needs of a photograph."""

    coefficients: Array  # (3, N) WᵀA⊥ᵀ y, y over its level and A⊥ over a patch's root mean energy
    noise: Array  # (3,) standard deviation of the noise in y, likewise
    level: float  # root mean square of the photograph, range(B) projected out
    share: float  # the level over the root mean square of the photograph itself
    noise_to_signal: float  # energy of the noise in y over that of the signal
    common: CommonNoise | None = None  # where the channels share noise

    @property
    def mean_noise(self) -> float:
        """The σ that λ is counted in, the mean of the channels'."""
        return float(self.noise.mean())


def root_mean_squares(planes: Array) -> Array:
    """Return the root mean square of each of (K, 3, M') photographs, (K,)."""
    return np.asarray(np.sqrt(np.mean(planes**2, axis=(1, 2))))


def noise_of(y: Any, coefficients: Any, curvatures: Any, rank: int) -> Any:
    """Return the standard deviation of what the least-squares hidden image leaves of y, (..., 3).

    y, (..., 3, M'), has range(B), of that rank, projected out. The coefficients, (..., 3, N'), and
    curvatures, (N',), are those of the patterns that the wall shows. The arrays are of any library.
    """
    xp, pixels = array_namespace(y), y.shape[-1]
    energies = xp.sum(y * y, axis=-1)
    left = energies - xp.sum(coefficients**2 / curvatures, axis=-1)
    freedom = max(pixels - rank - curvatures.shape[0], 1)
    noise = xp.sqrt(xp.clip(left, min=0.0) / freedom)
    # Without noise there still is finite precision; and a black channel is no oracle.
    rounding = 1e-7 * xp.sqrt(xp.max(energies, axis=-1, keepdims=True) / pixels) + 1e-30
    largest = xp.max(noise, axis=-1, keepdims=True)
    return xp.maximum(noise, xp.maximum(rounding, largest / LARGEST_RATIO))


def noise_to_signal(noise: Any, pixels: int, rank: int, patterns: int) -> Any:
    """Return the noise's energy over the signal's, (...); noise (..., 3), y of mean square 1."""
    xp = array_namespace(noise)
    energy = (pixels - rank) * xp.sum(noise**2, axis=-1)
    # A signal below its own standard error is none.
    least = xp.sqrt(2 * patterns * xp.sum(noise**4, axis=-1))
    return energy / xp.maximum(3 * pixels - energy, least)
