"""Noise that the channels share: uneven paint, a scene that is off, ambient light beyond the model.

A camera's noise is white and independent in the channels. What a wall or a scene does is alike in
all of them, and slow: along one axis of colours it hides the image, at low frequencies most, while
across that axis the photograph is as good as its camera. So where the covariance Σ of what [A, B]
leave of the channels shows that they share noise, the misfit is taken along Σ's own axes a, its
eigenvectors, pattern by pattern of `spectral_basis`: of z_ak = d_ak/√λ_k, whose noise has the
variance v_ak (see `noise_spectrum`),

    Σ_ak (z_ak − ẑ_ak)² (σ²/v_ak)^(p/2),   p = 1,

with σ the channels' mean noise. Total variation's norm over the channels is the same along any
orthonormal axes, which share their edges. The likelihood has p = 2. But an image of few edges is
best cut off at a threshold that goes with the noise, not with its square: with p = 2 and a λ that
suits the clean axes, the noisy one, which is all that a grey image has, is smoothed away. The λ
taken is the one of least predicted error, see `predicted_error`.

All of this is taken to the part s to which the channels share their noise, from 0 at `SHARED` to 1
at `ALL_SHARED`, so that no photograph stands at a jump: Σ's covariances are taken times s, v_ak is
σ_a^(2 − 2s) v_ak^s, p = 2 − s, and the factor on λ is taken to the power of s. Channels that are
copies of one are no other case: along the axes across, nothing is left of them.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from periscopy_sim.reconstruction.noise_aware.evidence import LARGEST_RATIO, CommonNoise
from periscopy_sim.reconstruction.noise_aware.nuisance.noise_spectrum import NoiseSpectrum

Array = NDArray[np.float64]

SHARED = 0.5
"""Part of the channels' noise, each over its own, along one axis from which they share it: of
independent ones it is a third, and of images of a rendered A at most half."""

ALL_SHARED = 0.6
"""Part from which it is taken for shared altogether."""

ROUNDING = 1e-6
"""Noise below this part of the photograph is rounding, which the channels may share."""


def noise_covariance(y: Array, coefficients: Array, curvatures: Array, rank: int) -> Array:
    """Return the covariance of what the least-squares image leaves of y, (3, 3); see `noise_of`."""
    left = y @ y.T - (coefficients / curvatures) @ coefficients.T
    return np.asarray(left / max(y.shape[1] - rank - len(curvatures), 1))


def shared_part(covariance: Array) -> float:
    """Return s, from 0 to 1: how far the channels of a photograph of mean square 1 share noise."""
    variances = np.diag(covariance)
    if not (variances > ROUNDING**2).all():
        return 0.0
    correlations = covariance / np.sqrt(np.outer(variances, variances))
    along = float(np.linalg.eigvalsh(correlations)[-1]) / 3
    return float(np.clip((along - SHARED) / (ALL_SHARED - SHARED), 0, 1))


def common_noise(
    covariance: Array, part: float, left: Array, spectrum: NoiseSpectrum
) -> CommonNoise:
    """Return the axes of a covariance, of which the channels share a part, and the noise in them.

    What a fit leaves of the photograph is (3, M').
    """
    own = np.diag(np.diag(covariance))
    variances, vectors = np.linalg.eigh(own + part * (covariance - own))
    variances = np.maximum(variances[::-1], variances[-1] / LARGEST_RATIO**2)
    axes = np.ascontiguousarray(vectors.T[::-1])
    found = spectrum.variances(axes @ left)
    found = np.maximum(found, found.max() / LARGEST_RATIO**2)
    blended = variances[:, None] ** (1 - part) * found**part
    return CommonNoise(axes, blended, part)
