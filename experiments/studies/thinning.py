"""A sparse P, for photographs so large that the product with a full one is slow or does not fit.

Every matrix P with P [A, Q] = [I, 0] recovers the hidden image and rejects range(B), where Q is an
orthonormal basis of that. The pseudoinverse of Eq. 8 is the one with the least noise; where A and Q
have N + r columns there are others with as few as N + r entries in each row of M. With the
factorization [Q, A] = U R the condition on a row p reads

    Uᵀ p = c,   c the coordinates of P's own row: p = U c for the pseudoinverse.

`sparse_preconditioner` looks for the row of least noise ‖p‖² with as many entries as wanted, by
backward elimination. On a support S the least noise has p = U_S (U_SᵀU_S)⁻¹ c. Leaving out entry j
as well raises ‖p‖² by

    p_j² / (1 − h_j),   h_j = U_j (U_SᵀU_S)⁻¹ U_jᵀ the leverage of row j of U_S;

the entries for which this is least are left out, a part at a time.

References
----------
Hassibi, Stork, "Second order derivatives for network pruning: optimal brain surgeon", 1992.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy import linalg, sparse

from periscopy_sim.reconstruction.preconditioned.preconditioner import Preconditioner

Array = NDArray[np.float64]
Real = NDArray[np.floating[Any]]
Index = NDArray[np.intp]

FIRST = 0.3
"""So much of a row, or three times N + r entries, is first kept by the size of its entries alone,
which costs 3 % of noise."""

KEPT = 0.6
"""Part of the entries beyond N + r that a round of the elimination keeps."""

DOUBLE_BELOW = 1.2
"""Supports of fewer than so many times N + r entries are chosen in double precision, since so few
rows of U can be nearly dependent; larger ones in single precision, in half the time."""


def sparse_preconditioner(
    P: Preconditioner,
    density: float,
    *,
    start: sparse.csr_array | None = None,
    progress: Callable[[float], None] | None = None,
) -> sparse.csr_array:
    """Return a sparse P that still fulfils P A = I and P Q = 0, with little noise.

    A row costs about 3 M (N + r)² operations.

    Parameters
    ----------
    P
        The preconditioner.
    density
        Part of the M entries of each row that may differ from zero.
    start
        A denser result to go on from; None starts from P.
    progress
        Called with the fraction done.

    Returns
    -------
    csr_array
        (N, M) float64.

    Raises
    ------
    ValueError
        If the density is above 1 or leaves fewer than N + r entries in a row, with which
        P [A, Q] = [I, 0] cannot hold; or `start` has fewer entries in a row than that.
    """
    U, coordinates = coordinates_of(P)
    M, unknowns = U.shape
    size = math.floor(density * M + 1e-9) if density <= 1 else M + 1
    if not unknowns <= size <= M:
        raise ValueError(
            f"the density is {density}: give at least {unknowns / M:.4f}, which is the number of "
            f"patches and background dimensions over that of pixels, and at most 1"
        )
    if start is not None and np.diff(start.indptr).min() < size:
        raise ValueError(f"start has rows of fewer than {size} entries: go on from a denser one")
    first = min(max(math.floor(FIRST * M), 3 * unknowns), M)
    U32 = U.astype(np.float32)
    indices, values = [], []
    for row, c in enumerate(coordinates):
        if start is None:
            support = _largest(np.abs(U @ c), max(size, first))
        else:
            support = start.indices[start.indptr[row] : start.indptr[row + 1]]
        for kept in _sizes(len(support), size, unknowns):
            single_or_double = U32 if kept > DOUBLE_BELOW * unknowns else U
            support = support[_largest(_removal_cost(single_or_double[support], c), kept)]
        support = np.sort(support)
        indices.append(support)
        values.append(_least_noise(U[support], c))
        if progress is not None:
            progress((row + 1) / len(coordinates))
    narrow = sparse.get_index_dtype(maxval=max(M, len(indices) * size))
    pointers = np.arange(len(indices) + 1, dtype=narrow) * size
    return sparse.csr_array(
        (np.concatenate(values), np.concatenate(indices, dtype=narrow), pointers),
        (len(indices), M),
    )


def coordinates_of(P: Preconditioner) -> tuple[Array, Array]:
    """Return U, (M, r + N), and every row's c, (N, r + N): with [Q, A] = U R, P = [0 I] R⁻¹ Uᵀ."""
    U, R = linalg.qr(np.hstack([P.Q, P.A]), mode="economic", check_finite=False)
    inverse = linalg.solve_triangular(R, np.eye(len(R)), check_finite=False)
    return U, inverse[P.Q.shape[1] :]


def _sizes(first: int, last: int, unknowns: int) -> list[int]:
    """Return the size of the support after each round; what is beyond the unknowns falls by `KEPT`.

    A little less than the unknowns, as there the last size may be all of them.
    """
    needed = 0.95 * unknowns
    ratio = (last - needed) / (first - needed)
    rounds = math.ceil(math.log(ratio) / math.log(KEPT))
    return [round(needed + (first - needed) * ratio ** (k / rounds)) for k in range(1, rounds + 1)]


def _removal_cost(U: Real, c: Array) -> Real:
    """Evaluate p_j² / (1 − h_j) for the p of least noise with Uᵀp = c, in U's precision."""
    rounding = 10 * np.finfo(U.dtype).eps  # the eigenvalues of UᵀU are at most 1
    gram = U.T @ U
    gram[np.diag_indices_from(gram)] += rounding
    R = linalg.cholesky(gram, check_finite=False)
    p = U @ linalg.cho_solve((R, False), c.astype(U.dtype), check_finite=False)
    whitened = linalg.solve_triangular(R, U.T, trans="T", check_finite=False)
    leverage = np.sum(whitened**2, axis=0)
    cost: Real = p**2 / np.maximum(1 - leverage, rounding)
    return cost


def _least_noise(U: Array, c: Array) -> Array:
    """Return the p of least norm with Uᵀp = c, refined once: few rows of U are ill-conditioned."""
    factor = linalg.cho_factor(U.T @ U, check_finite=False)
    p = U @ linalg.cho_solve(factor, c, check_finite=False)
    refined: Array = p + U @ linalg.cho_solve(factor, c - U.T @ p, check_finite=False)
    return refined


def _largest(values: Real, count: int) -> Index:
    return np.argpartition(values, len(values) - count)[len(values) - count :]
