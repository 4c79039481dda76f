"""Noise that the channels share: uneven paint, a scene that is off, ambient light beyond the model.

A camera's noise is independent in the channels. What a wall or a scene does is not, and it is slow
besides: along the one axis of colours that it has in common it hides the image, at low frequencies
most, where the image is, while across that axis the photograph is as good as its camera. So where
the channels' covariance Σ of what [A, B] leave shows such an axis, the misfit is taken in Σ's own
axes a, the eigenvectors, each weighed by its noise,

    Σ_a ‖A⊥ f_a − y⊥_a‖² / σ_a^(3/2).

Total variation's norm over the channels is the same in any axes, and its edges, which the clean
axes show, lead the other. The power is between 2, the likelihood's, which leaves the noisy axis too
little against a λ that follows σ, and 1, at which λ follows each axis's own.

Slow noise is stronger than its mean σ_a where the image is: by κ_a in variance, told by smoothing
what is left, beside white noise that went through the same fit. λ is κ^⅓ times as large, of the
noisiest axis, and the standard errors count the noise κ_a times. Powers were chosen on four
stand-ins with paint uneven by 0.4 %.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy import ndimage

from periscopy_sim.reconstruction.noise_aware.evidence import LARGEST_RATIO

Array = NDArray[np.float64]

SHARED = 0.6
"""Part of the channels' noise, each over its own, along one axis from which they share it: of
independent ones it is a third, and of images of a rendered A at most half."""

COPIES = 0.9995
"""Correlation of two channels from which they are one, as in a grey photograph, or where hot pixels
are all that is left: neither is noise that they share."""

ROUNDING = 1e-6
"""Noise below this part of the photograph is rounding, which the channels may share."""

SCALES = (1.0, 2.0, 4.0)
"""Standard deviations, in pixels, of the Gaussians that slow noise is looked for by."""

LEAST_LEFT = 0.1
"""Of smoothed white noise, that a fit leaves: where it is less, nothing can be told."""


@dataclass(frozen=True, eq=False)
class CommonNoise:
    """Axes of colour in which noise is independent."""

    axes: Array  # (3, 3) orthonormal, an axis a row, the noisiest first
    σ: Array  # (3,) noise along them
    slow: Array  # (3,) κ ≥ 1, its variance at low frequencies over σ²


def noise_covariance(y: Array, coefficients: Array, curvatures: Array, rank: int) -> Array:
    """Return the covariance of what the least-squares image leaves of y, (3, 3); see `noise_of`."""
    left = y @ y.T - (coefficients / curvatures) @ coefficients.T
    return np.asarray(left / max(y.shape[1] - rank - len(curvatures), 1))


def is_shared(covariance: Array) -> bool:
    """Return whether the channels of a photograph of mean square 1 share most of their noise."""
    variances = np.diag(covariance)
    if not (variances > ROUNDING**2).all():
        return False
    correlations = covariance / np.sqrt(np.outer(variances, variances))
    if np.abs(correlations[np.triu_indices(3, 1)]).max() > COPIES:
        return False
    return bool(np.linalg.eigvalsh(correlations)[-1] > 3 * SHARED)


def common_noise(covariance: Array, left: Array, white: Array) -> CommonNoise:
    """Return the axes of a covariance, and how slow the noise along them is.

    What a fit leaves of the photograph is (3, rows, columns), and of white noise of variance 1
    (K, rows, columns); both are 0 where pixels are left out.
    """
    variances, vectors = np.linalg.eigh(covariance)
    σ = np.sqrt(np.maximum(variances[::-1], variances[-1] / LARGEST_RATIO**2))
    axes = np.ascontiguousarray(vectors.T[::-1])
    along = np.tensordot(axes, left, 1)
    slow = np.ones(3)
    for scale in SCALES:
        smooth, expected = (
            np.mean(ndimage.gaussian_filter(planes, (0, scale, scale)) ** 2, axis=(1, 2))
            for planes in (along, white)
        )
        unfitted = np.mean(_smoothed_white(white.shape[1:], scale))
        if expected.mean() < LEAST_LEFT * unfitted:
            break
        energies = np.mean(along**2, axis=(1, 2)) / np.mean(white**2)
        slow = np.maximum(slow, smooth / expected.mean() / energies)
    return CommonNoise(axes, σ, slow)


def _smoothed_white(shape: tuple[int, ...], scale: float) -> Array:
    """Return the mean energy of white noise that is smoothed, but not fitted."""
    noise = np.random.default_rng(0).standard_normal(shape)
    return np.asarray(ndimage.gaussian_filter(noise, scale) ** 2)
