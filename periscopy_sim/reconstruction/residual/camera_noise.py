"""The camera's noise, from differences of neighbouring pixels: no scene is asked.

The difference D = (1, −2, 1)ᵀ(1, −2, 1)/6 leaves nothing of light that varies linearly down or
across, little of penumbrae, and of white noise its whole variance. So its size bounds the noise
from above, whatever the wall shows. Noise that neighbours share, as after rectification, comes out
too small; paint that is uneven from pixel to pixel comes out as noise, and only its likeness in the
channels tells it apart (`structure`).
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]

TILE = 32
"""Rows and columns in which noise is taken to be alike; it may follow the light from one to the
next."""

KEPT = 0.7
"""Part of a tile's differences that count, the smallest: an edge through a tile is left out."""

KEPT_VARIANCE = 0.3094
"""Mean square of the smallest `KEPT` of the absolute values of a standard normal variable."""

SHARED = (70 / 36) ** 2
"""Sum of the squared correlations of D's values with each other, under white noise."""

SPREAD = 1.65
"""Standard error over σ, times the root of the number of differences (measured)."""

FEWEST = 25
"""Differences from which noise is told."""


@dataclass(frozen=True, eq=False)
class CameraNoise:
    """White noise of a photograph's channels."""

    σ: Array  # (3,)
    standard_error: Array  # (3,) of σ

    def times(self, factor: float) -> CameraNoise:
        """Return so many times the noise."""
        return CameraNoise(factor * self.σ, factor * self.standard_error)


def neighbour_differences_of(planes: Array) -> Array:
    """Return D of (3, rows, columns) planes, (3, rows − 2, columns − 2); NaN beside NaN."""
    down = np.diff(planes, n=2, axis=1)
    return np.asarray(np.diff(down, n=2, axis=2) / 6)


def camera_noise(planes: Array) -> CameraNoise | None:
    """Return the white noise of (3, rows, columns) planes, NaN where pixels are left out.

    None where fewer than `FEWEST` pixels have all their neighbours.
    """
    differences = neighbour_differences_of(planes)
    count = int(np.isfinite(differences[0]).sum()) if differences.size else 0
    if count < FEWEST:
        return None
    σ = np.sqrt([_variance(channel) for channel in differences])
    return CameraNoise(σ, σ * SPREAD / np.sqrt(count))


def _variance(differences: Array) -> float:
    """Return the mean over tiles of the variance that their smallest differences tell."""
    rows, columns = (max(1, round(size / TILE)) for size in differences.shape)
    total = 0.0
    number = 0
    for strip in np.array_split(differences, rows, axis=0):
        for tile in np.array_split(strip, columns, axis=1):
            squares = np.sort(tile[np.isfinite(tile)] ** 2)
            if len(squares):
                total += len(squares) * float(_smallest(squares)) / KEPT_VARIANCE
                number += len(squares)
    return total / number


def _smallest(squares: Array) -> float:
    """Return the mean of the smallest `KEPT` of sorted numbers, the last of them in part."""
    whole, part = divmod(KEPT * len(squares), 1)
    total = squares[: int(whole)].sum() + part * squares[min(int(whole), len(squares) - 1)]
    return float(total / (KEPT * len(squares)))
