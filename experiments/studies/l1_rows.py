"""Rows of P of least ‖p‖₁, the sparsifying term that the paper mentions (Sec. 3).

They have N + r entries, but more noise than the rows of least ‖p‖ with as many, see
`experiments.studies.thinning`.

References
----------
Dokmanić, Gribonval, "Beyond Moore-Penrose: sparse pseudoinverse", 2013.
Boyd et al., "Distributed optimization and statistical learning via the alternating direction
method of multipliers", 2011, Sec. 6.2.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from experiments.studies.thinning import coordinates_of
from periscopy_sim.reconstruction.preconditioned.preconditioner import Preconditioner

Array = NDArray[np.float64]


def l1_minimal_rows(
    P: Preconditioner,
    rows: Sequence[int],
    *,
    tolerance: float = 1e-5,
    max_iterations: int = 20_000,
) -> Array:
    """Return rows p of least ‖p‖₁ with p [A, Q] = [e, 0], by ADMM.

    Parameters
    ----------
    P
        The preconditioner.
    rows
        Which of its N rows.
    tolerance
        Stop when both residuals of ADMM are at most this part of the rows' norm.
    max_iterations
        Most iterations.

    Returns
    -------
    ndarray
        (len(rows), M). They fulfil the condition, and are sparse up to the tolerance.

    Raises
    ------
    RuntimeError
        If the iterations do not suffice.
    """
    U, coordinates = coordinates_of(P)
    pseudoinverse = coordinates[rows] @ U.T
    # Its inverse is the penalty of ADMM. Only the speed depends on it.
    threshold = np.abs(pseudoinverse).mean(axis=1, keepdims=True) / 2
    sparse_rows, dual = pseudoinverse, np.zeros_like(pseudoinverse)
    for _ in range(max_iterations):
        shifted = sparse_rows - dual
        feasible: Array = shifted - (shifted @ U) @ U.T + pseudoinverse
        previous, shifted = sparse_rows, feasible + dual
        sparse_rows = np.sign(shifted) * np.maximum(np.abs(shifted) - threshold, 0)
        dual = shifted - sparse_rows
        residual = max(
            float(np.linalg.norm(feasible - sparse_rows)),
            float(np.linalg.norm(sparse_rows - previous)),
        )
        if residual <= tolerance * float(np.linalg.norm(feasible)):
            return feasible
    raise RuntimeError(f"ADMM has not converged in {max_iterations} iterations")
