"""Evidence of a hidden image in a photograph: its noise, its signal, and whether it shows any."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]

LARGEST_RATIO = 30
"""Between the noises of two channels: one that has less is not believed."""

LEAST_SHARE = 1e-6
"""Of a photograph, range(B) projected out: where less is left, it is no more than rounding."""

SIGNIFICANT = 3
"""Standard errors of noise: what A⊥ can explain of a photograph is more, or it is noise."""

LEAST_EXPLAINED = 0.2
"""Of what A⊥ can explain of a photograph: where the image explains less, it is mostly noise."""


@dataclass(frozen=True, eq=False)
class Evidence:
    """All that the objective needs of a photograph.

    Attributes
    ----------
    coefficients
        (3, N) WᵀA⊥ᵀ y, y over its level.
    noise
        (3,) standard deviation of y, likewise.
    level
        Root mean square of the photograph, range(B) projected out.
    share
        This over the root mean square of the photograph itself.
    noise_to_signal
        Energy of the noise in y over that of the signal.
    """

    coefficients: Array
    noise: Array
    level: float
    share: float
    noise_to_signal: float


def root_mean_squares(planes: Array) -> Array:
    """Return the root mean square of each of (K, 3, M') photographs, (K,)."""
    return np.asarray(np.sqrt(np.mean(planes**2, axis=(1, 2))))


def noise_of(y: Array, coefficients: Array, curvatures: Array, rank: int) -> Array:
    """Return the standard deviation of what the least-squares hidden image leaves, (3,).

    Parameters
    ----------
    y
        (3, M') photograph, range(B) projected out.
    coefficients, curvatures
        (3, N'), (N',) those of the patterns that the wall shows.
    rank
        Of B.
    """
    energies = np.einsum("cm,cm->c", y, y)
    left = energies - (coefficients**2 / curvatures).sum(axis=1)
    freedom = max(y.shape[1] - rank - len(curvatures), 1)
    noise: Array = np.sqrt(np.maximum(left, 0) / freedom)
    # Without noise there still is finite precision; and a black channel is no oracle.
    rounding = 1e-7 * np.sqrt(energies.max() / y.shape[1]) + 1e-30
    return np.maximum(noise, max(rounding, float(noise.max()) / LARGEST_RATIO))


def noise_to_signal(noise: Array, pixels: int, rank: int, patterns: int) -> float:
    """Return the noise's energy over the signal's, of y of mean square 1."""
    energy = (pixels - rank) * float(np.sum(noise**2))
    # A signal below its own standard error is none.
    least = np.sqrt(2 * patterns * np.sum(noise**4))
    return float(energy / max(3 * pixels - energy, least))


def doubt_of(share: float, whole: float, left: float, patterns: int) -> str:
    """Return why a photograph may show nothing of a hidden image; empty where nothing says so.

    Parameters
    ----------
    share
        That of `Evidence`.
    whole, left
        Energy of the photograph that the patterns can explain, and that the image leaves of it,
        over the noise's variance and summed over the channels.
    patterns
        How many of them the wall shows.
    """
    if share < LEAST_SHARE:
        return "the photograph shows no hidden image: ambient light alone explains all of it"
    is_noise = whole - 3 * patterns < SIGNIFICANT * np.sqrt(6 * patterns)
    if is_noise or whole - left < LEAST_EXPLAINED * whole:
        return (
            "the photograph hardly shows a hidden image: what the scene explains of it is no more "
            "than noise"
        )
    return ""
