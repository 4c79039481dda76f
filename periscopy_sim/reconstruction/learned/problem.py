"""The problem that the network solves: a photograph's evidence by the noise-aware method."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from periscopy_sim.reconstruction.noise_aware.solution import NoiseAwareReconstruction
from periscopy_sim.reconstruction.noise_aware.still import NoiseAware

Array = NDArray[np.float64]
Single = NDArray[np.float32]

LEAST_ERROR = 1e-4
"""Over the image's scale: no error is believed to be smaller."""


@dataclass(frozen=True, eq=False)
class Problem:
    """A photograph as the network takes it, images over their `scale`; see `Problems`."""

    axes: Single  # (3, 3)
    data: Single  # (3, N)
    weights: Single  # (3, N)
    errors: Single  # (R, C)
    start: Single  # (3, R, C)
    scale: float  # of the image, in units of the photograph's over those of A


def problem_of(method: NoiseAware, found: NoiseAwareReconstruction) -> Problem | None:
    """Return the problem of a photograph from its noise-aware solution; None of a black image."""
    evidence, curvatures = found.evidence, method._basis.curvatures
    start = np.moveaxis(found.image, -1, 0) * (method._unit / evidence.level)
    scale = float(np.sqrt(np.mean(start**2)))
    if not scale > 0:
        return None
    start = start / scale
    if evidence.common is None:
        axes, variances = np.eye(3), np.tile((evidence.noise**2)[:, None], len(curvatures))
    else:
        # As the noise-aware method weighs them.
        σ, axes = evidence.mean_noise, evidence.common.axes
        seen = σ**2 / evidence.common.weights(σ)
        unseen = np.repeat(seen[:, :1], len(curvatures) - seen.shape[1], axis=1)
        variances = np.concatenate([unseen, seen], axis=1)
    weights = scale**2 / variances
    data = weights * (axes @ evidence.coefficients) / scale
    # Images of this contrast: a Gaussian prior of precision p K, K = ∇ᵀ∇ + I.
    slopes = sum(np.sum(np.diff(start, axis=axis) ** 2) for axis in (1, 2))
    p = start.size / float(slopes + np.sum(start**2))
    spread = np.mean(1 / (weights * curvatures + p), axis=0)
    errors = np.sqrt(np.maximum(spread.astype(np.float32) @ method._basis.rows**2, LEAST_ERROR**2))
    return Problem(
        axes=axes.astype(np.float32),
        data=data.astype(np.float32),
        weights=weights.astype(np.float32),
        errors=errors.reshape(method.hidden_shape),
        start=start.astype(np.float32),
        scale=scale * evidence.level / method._unit,
    )
