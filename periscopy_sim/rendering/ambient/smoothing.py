"""Smooth fields from noisy samples: how smooth they are is decided by independent replicas."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from periscopy_sim.rendering.wall_polynomials import polynomial_fits
from periscopy_sim.scenario import Array


@dataclass(frozen=True, eq=False)
class Field:
    """Independent estimates of a field."""

    replicas: Array  # (K, M, 3) at the pixels
    squared_bias: Array  # (3,) of all replicas alike, averaged over pixels
    largest: tuple[int, int] | None  # powers of row and column; None of the samples themselves

    @property
    def squared_error(self) -> float:
        """Expected squared error of the replicas' mean, averaged over pixels and channels."""
        variance = self.replicas.var(axis=0, ddof=1).mean() / len(self.replicas)
        return float(variance + self.squared_bias.mean())


def best_estimate(replicas: Array, sites: NDArray[np.intp], shape: tuple[int, int]) -> Field:
    """Fit polynomials of row and column by least squares, and take those of least error.

    Where every pixel was sampled, the samples themselves compete. `replicas` are (K, S, 3)
    estimates, K of at least 2, at the (S,) row-major indices `sites`.
    """
    best = min(
        polynomial_fits(replicas, sites, shape), key=lambda fit: float(fit.squared_error.mean())
    )
    fitted = best.fields.transpose(1, 0, 2)
    smooth = Field(fitted, best.squared_bias, best.largest)
    if np.array_equal(sites, np.arange(shape[0] * shape[1])):
        return min(
            Field(replicas, np.zeros(3), None), smooth, key=lambda field: field.squared_error
        )
    return smooth
