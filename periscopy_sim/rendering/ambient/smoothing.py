"""Smooth fields from noisy samples: how smooth they are is decided by independent replicas."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from periscopy_sim.rendering.wall_polynomials import polynomials
from periscopy_sim.scenario import Array

DEPENDENT = 1e-10
"""Polynomials are taken as dependent on the sites below this part of the first one's norm."""


@dataclass(frozen=True, eq=False)
class Field:
    """Independent estimates of a field."""

    replicas: Array  # (K, M, 3) at the pixels
    squared_bias: Array  # (3,) of all replicas alike, averaged over the sites
    degree: int | None  # total, of the polynomial that was best; None of the samples themselves

    @property
    def squared_error(self) -> float:
        """Expected squared error of the replicas' mean, averaged over pixels and channels."""
        variance = self.replicas.var(axis=0, ddof=1).mean() / len(self.replicas)
        return float(variance + self.squared_bias.mean())


def best_estimate(replicas: Array, sites: NDArray[np.intp], shape: tuple[int, int]) -> Field:
    """Fit polynomials in row and column by least squares, and take the degree of least error.

    The residuals of two independent replicas share only the fit's bias, so that the mean of their
    products estimates its square without bias; with the variance over the replicas it gives the
    squared error of each degree. Where every pixel was sampled, the samples themselves compete.
    `replicas` are (K, S, 3) estimates, K of at least 2, at the (S,) row-major indices `sites`.
    """
    K, M = len(replicas), shape[0] * shape[1]
    candidates = []
    if np.array_equal(sites, np.arange(M)):
        candidates.append(Field(replicas, np.zeros(3), None))
    basis, degrees = polynomials(shape)
    side_by_side = replicas.transpose(1, 0, 2).reshape(len(sites), -1)
    Q, R = np.linalg.qr(basis[sites])
    for degree in range(degrees[-1] + 1):
        n = np.count_nonzero(degrees <= degree)
        if n > len(sites) or np.abs(np.diag(R)[:n]).min() < DEPENDENT * np.abs(R[0, 0]):
            break
        fit = basis[:, :n] @ np.linalg.solve(R[:n, :n], Q[:, :n].T @ side_by_side)
        fitted = fit.reshape(M, K, -1).transpose(1, 0, 2)
        residual = fitted[:, sites] - replicas
        products = residual.sum(axis=0) ** 2 - (residual**2).sum(axis=0)
        bias = np.maximum((products / (K * (K - 1))).mean(axis=0), 0)
        candidates.append(Field(fitted, bias, degree))
    return min(candidates, key=lambda field: field.squared_error)
