"""The problem that the network solves: a photograph's evidence by the noise-aware method."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from periscopy_sim.reconstruction.noise_aware.noise_aware import (
    NoiseAware,
    NoiseAwareReconstruction,
)

Single = NDArray[np.float32]

LEAST_ERROR = 1e-4
"""Over the image's scale: no error is believed to be smaller."""


@dataclass(frozen=True, eq=False)
class Problem:
    """A photograph as the network reads it, images over their `scale`; see `Problems`."""

    data: Single  # (3, N)
    weights: Single  # (3, N)
    errors: Single  # (R, C)
    start: Single  # (3, R, C)
    scale: float  # of the image, in units of the photograph's over those of A


def problem_of(method: NoiseAware, solution: NoiseAwareReconstruction) -> Problem | None:
    """Return the problem of a photograph from its noise-aware solution; None of a black image."""
    evidence, patterns = solution.evidence, method.fit.patterns
    # The network takes each of the monitor's primaries on its own.
    unmixing = np.linalg.inv(method.observation.mixing)
    coefficients, variances = unmixing @ evidence.coefficients, unmixing**2 @ evidence.noise**2
    start = np.moveaxis(solution.image, -1, 0) * (method.fit.unit / evidence.level)
    scale = float(np.sqrt(np.mean(start**2)))
    if not scale > 0:
        return None
    start = start / scale
    weights = scale**2 / np.tile(variances[:, None], len(patterns.curvatures))
    data = weights * coefficients / scale
    # Images of this contrast: a Gaussian prior of precision p K, K = ∇ᵀ∇ + I.
    slopes = np.sum(method.hidden.differences(start.reshape(3, -1).T) ** 2)
    p = start.size / float(slopes + np.sum(start**2))
    spread = np.mean(1 / (weights * patterns.curvatures + p), axis=0)
    errors = np.sqrt(np.maximum(spread.astype(np.float32) @ patterns.rows**2, LEAST_ERROR**2))
    return Problem(
        data=data.astype(np.float32),
        weights=weights.astype(np.float32),
        errors=errors.reshape(method.hidden_shape),
        start=start.astype(np.float32),
        scale=scale * evidence.level / method.fit.unit,
    )
