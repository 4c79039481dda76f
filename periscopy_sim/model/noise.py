"""The camera's noise, from differences of neighbouring pixels: no scene is needed.

The difference D = (1, −2, 1)ᵀ(1, −2, 1)/6 removes light that varies linearly down or across, most
of penumbrae, and keeps the whole variance of white noise. The median of its size is that of noise
even where some edges remain. Noise that neighbours share, as after rectification, comes out too
small.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]

FEWEST = 25
"""Pixels with all their neighbours, below which no noise is estimated."""

NORMAL = 1.4826
"""Standard deviation of a normal variable over the median of its size."""


def second_differences(planes: Array) -> Array:
    """Return D of (K, rows, columns) planes, (K, rows − 2, columns − 2); NaN beside NaN."""
    return np.asarray(np.diff(np.diff(planes, n=2, axis=1), n=2, axis=2) / 6)


def camera_noise(planes: Array) -> Array | None:
    """Return the standard deviation of white noise in each of (K, rows, columns) planes, (K,).

    NaN marks pixels that are not used. None where fewer than `FEWEST` pixels have all their
    neighbours.
    """
    if min(planes.shape[1:]) < 3:
        return None
    differences = np.abs(second_differences(planes)).reshape(len(planes), -1)
    used = np.isfinite(differences).all(axis=0)
    if np.count_nonzero(used) < FEWEST:
        return None
    return np.asarray(NORMAL * np.median(differences[:, used], axis=1))
