"""The evidence of a regularized fit for any weight of its prior, by one tridiagonal matrix.

    G = A⊥ᵀA⊥,   K = L Lᵀ,   L⁻¹ G L⁻ᵀ = Q T Qᵀ,   z = Qᵀ L⁻¹ h,

T tridiagonal, Q orthogonal. Then log det(I + K⁻¹G/α) = log det(I + T/α), and the best fit,
(G + αK) f = h, explains hᵀf = zᵀ(T + αI)⁻¹z: each α takes O(N), and no eigenvectors are needed
(Eldén, BIT 17, 1977).
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Self

import numpy as np
from numpy.typing import NDArray
from scipy import linalg
from scipy.linalg import lapack

Array = NDArray[np.float64]

BLOCK = 64
"""Columns that LAPACK works on at a time."""


@dataclass(frozen=True, eq=False)
class RidgePath:
    """Regularized fits f to some h, (N, J), by any weight of the prior."""

    diagonal: Array  # (N,) of T
    beside: Array  # (N - 1,) of T; of a single patch a number that does not count
    pulls: Array  # (N, J) z
    _root: Array
    _reflections: tuple[Array, Array]

    @classmethod
    def of(cls, gram: Array, K: Array, h: Array) -> Self:
        """Return the fits to h, (N, J), of G and K, both (N, N), symmetric, K positive definite."""
        root, work = linalg.cholesky(K, lower=True, check_finite=False), BLOCK * len(K)
        reduced, _ = lapack.dsygst(gram.T, root, lower=1)
        vectors, diagonal, beside, scales, _ = lapack.dsytrd(
            reduced, lower=1, lwork=work, overwrite_a=1
        )
        reflections = np.asfortranarray(vectors[1:, :-1]), scales
        z = linalg.solve_triangular(root, h, lower=True, check_finite=False)
        beside = beside if len(beside) else np.zeros(1)
        return cls(diagonal, beside, _reflected(reflections, z, "T"), root, reflections)

    def volume_and_explained(self, α: float, j: int) -> tuple[float, float]:
        """Return log det(I + T/α), and zᵀ(T + αI)⁻¹z of a column of h.

        Where rounding outweighs α the first is infinite.
        """
        pivots, ratios, failed = lapack.dpttrf(self.diagonal + α, self.beside)
        if failed:
            return np.inf, 0.0
        z = self.pulls[:, j]
        explained = float(z @ lapack.dpttrs(pivots, ratios, z)[0])
        return float(np.log(pivots / α).sum()), explained

    def fit(self, α: float, j: int) -> Array:
        """Return (G + αK)⁻¹ h, (N,), of a column of h."""
        pivots, ratios, _ = lapack.dpttrf(self.diagonal + α, self.beside)
        z, _ = lapack.dpttrs(pivots, ratios, self.pulls[:, j])
        turned = _reflected(self._reflections, z[:, None], "N")[:, 0]
        return np.asarray(
            linalg.solve_triangular(self._root, turned, trans=1, lower=True, check_finite=False)
        )


def _reflected(reflections: tuple[Array, Array], vectors: Array, transposed: str) -> Array:
    """Return Q, or with "T" its transpose, times vectors, (N, J)."""
    turned = np.array(vectors, order="F")
    if len(turned) > 1:
        turned[1:], _, _ = lapack.dormqr(
            "L", transposed, *reflections, turned[1:], BLOCK * max(turned.shape)
        )
    return turned


def inverse(H: Array) -> Array:
    """Return the inverse of a positive definite matrix, (N, N)."""
    factor = linalg.cholesky(H, lower=True, check_finite=False)
    lower = np.tril(lapack.dpotri(factor, lower=1)[0])
    return np.asarray(lower + np.tril(lower, -1).T)
