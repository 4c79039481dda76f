"""The numerical range of B: what prototype backgrounds span, to working precision."""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy import linalg

Array = NDArray[np.float64]

RANK_TOLERANCE = 1e-10
"""Relative tolerance on the singular values of B that are kept; see `background_basis`."""

ROUNDING = 1e-12
"""Of a column: what is left of it outside of a subspace, and is no more than rounding."""

SKETCH = 96
"""Random mixtures of B's columns that are tried first: twice its usual rank of 44."""


def background_basis(B: NDArray[np.floating[Any]], rank_tolerance: float = RANK_TOLERANCE) -> Array:
    """Return an orthonormal basis Q, (M, r) float64, of the numerical range of B, (M, L).

    B is rank-deficient to working precision: its lights are far away, so their responses are nearly
    the same few smooth fields. Kept are the left singular vectors of B, its columns scaled to unit
    norm, whose singular values exceed `rank_tolerance`, in (0, 1), times the largest. Below about
    1e-13 the vectors kept are rounding errors, no light.
    """
    if not 0 < rank_tolerance < 1:
        raise ValueError(f"the rank tolerance must lie between 0 and 1, not {rank_tolerance}")
    B = np.asarray(B, np.float64)
    if not np.isfinite(B).all():
        raise ValueError("B must be finite")
    norms = np.sqrt(np.einsum("ij,ij->j", B, B))
    if not norms.any():
        return np.zeros((B.shape[0], 0))
    scale: Array = np.divide(1, norms, where=norms > 0, out=norms * 0)
    sketched = _sketched_basis(B, scale, rank_tolerance)
    if sketched is not None:
        return sketched
    scaled = B[:, norms > 0] / norms[norms > 0]
    # SVD of the triangular factor of a QR decomposition: several times faster than of B itself.
    (reflectors, tau), R = linalg.qr(scaled, mode="raw", check_finite=False)
    U, σ, _ = linalg.svd(R[: len(tau)], full_matrices=False)
    kept = U[:, σ > rank_tolerance * σ[0]]
    padded = np.zeros((B.shape[0], kept.shape[1]), order="F")
    padded[: len(kept)] = kept
    Q, _, info = linalg.lapack.dormqr(
        "L", "N", reflectors[:, : len(tau)], tau, padded, lwork=64 * len(tau)
    )
    assert info == 0
    return np.asarray(Q)


def joined_basis(Q: Array, columns: NDArray[np.floating[Any]]) -> Array:
    """Return an orthonormal basis of range(Q), (M, r), and of a few columns, (M, K), beside it.

    Q is orthonormal. However little of a column lies outside of range(Q), it is kept, but for
    rounding.
    """
    outside = np.asarray(columns, np.float64)
    sizes = np.linalg.norm(outside, axis=0)
    for _ in range(2):  # once more for what rounding left
        outside = outside - Q @ (Q.T @ outside)
    own = outside[:, np.linalg.norm(outside, axis=0) > ROUNDING * sizes]
    return np.hstack([Q, background_basis(own)])


def _sketched_basis(
    B: NDArray[np.floating[Any]], scale: Array, rank_tolerance: float
) -> Array | None:
    """Find the basis from the products of scaled B with a few random vectors, if so few suffice.

    Halko, Martinsson, Tropp, "Finding structure with randomness", 2011, Sec. 1.5: where the last
    singular value within the sketch is far below the tolerance, nothing above it lies outside.
    """
    if B.shape[1] <= 2 * SKETCH:
        return None
    random = np.random.default_rng(0).standard_normal((B.shape[1], SKETCH))
    mixtures = B @ (scale[:, np.newaxis] * random)
    S, _ = np.linalg.qr(mixtures)
    U, σ, _ = np.linalg.svd((S.T @ B) * scale, full_matrices=False)
    if σ[-1] > 1e-3 * rank_tolerance * σ[0]:
        return None
    return np.asarray(S @ U[:, σ > rank_tolerance * σ[0]])
