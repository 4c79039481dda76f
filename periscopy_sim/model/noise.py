"""The camera's noise: from neighbouring pixels, where no scene is needed, or from a fit's residual.

The difference D = (1, −2, 1)ᵀ(1, −2, 1)/6 removes light that varies linearly down or across, most
of penumbrae, and keeps the whole variance of white noise. The median of its size is that of noise
even where some edges remain. Where neighbours share noise, as after rectification, this estimate
is too small.
"""

import warnings
from statistics import NormalDist

import numpy as np

from periscopy_sim.numerics import Array, Image
from periscopy_sim.photograph import Photograph

FEWEST = 25
"""Pixels with all their neighbours, below which the noise is unknown."""

SINGLE_ROUNDING = float(np.finfo(np.float32).eps)
"""Noise over a photograph's size that rounding in single precision makes."""

STRONGEST = 64
"""Patterns whose light is subtracted before the noise is a difference of sums of squares, whose
rounding in single precision would else be as large as the noise of a photograph at 70 dB."""


def residual_noise(energy: Array, explained: Array, freedom: int) -> Array:
    """Return σ of white noise from the residual of least squares, of the shape of the energies.

    σ² = (‖y⊥‖² − ‖A⊥ f̂‖²)/freedom, or what rounding makes, if more. The energy is ‖y⊥‖² of each
    photograph's channels, `explained` is ‖A⊥ f̂‖², and the freedom counts the pixels less the
    dimensions of ambient light and f̂. It warns where more is explained than there is.
    """
    if np.any(explained - energy > 10 * SINGLE_ROUNDING * energy):
        warnings.warn(
            "rounding explains more of the photograph's light than there is, so that its noise "
            "counts as none: reconstruct fewer patches",
            stacklevel=2,
        )
    rest = np.maximum(energy - explained, SINGLE_ROUNDING**2 * energy)
    return np.asarray(np.sqrt(rest / max(freedom, 1)))


def noise_beside(lights: Image, y: Array, coordinates: Array, freedom: int) -> Array:
    """Return σ, (K, C), of y⊥, (K, C, M'), from what orthonormal rows of light leave of it.

    The lights are (N', M') in single precision, the strongest last; y⊥ has the coordinates,
    (K, C, N'), along them. The freedom is that of `residual_noise`.
    """
    from periscopy_sim.numerics.products import combine_rows  # compiled: readers need no compiler

    weak, strong = np.split(coordinates, [-STRONGEST], axis=-1)
    strong = strong.reshape(-1, strong.shape[-1]).astype(np.float32)
    left = y - combine_rows(strong, lights[-STRONGEST:]).reshape(y.shape)
    energy = np.sum(y * y, axis=-1)
    rest = np.sum(left**2, axis=-1) - np.sum(weak**2, axis=-1)
    return residual_noise(energy, energy - rest, freedom)


def second_differences(planes: Array) -> Array:
    """Return D of (K, rows, columns) planes, (K, rows − 2, columns − 2); NaN beside NaN."""
    return np.asarray(np.diff(np.diff(planes, n=2, axis=1), n=2, axis=2) / 6)


def camera_noise(planes: Array) -> Array | None:
    """Return the standard deviation of white noise in each of (K, rows, columns) planes, (K,).

    NaN marks pixels that are not used. None where fewer than `FEWEST` pixels have all their
    neighbours.
    """
    differences = np.abs(second_differences(planes)).reshape(len(planes), -1)
    used = np.isfinite(differences).all(axis=0)
    if np.count_nonzero(used) < FEWEST:
        return None
    return np.asarray(np.median(differences[:, used], axis=1) / NormalDist().inv_cdf(0.75))


def relative_noise(photograph: Photograph) -> float | None:
    """Return the least noise of a channel over its mean.

    None where `camera_noise` returns None, or all is black.
    """
    noise, light = camera_noise(photograph.planes), np.nanmean(photograph.planes, axis=(1, 2))
    if noise is None or not (light > 0).any():
        return None
    return float(np.min(noise[light > 0] / light[light > 0]))
