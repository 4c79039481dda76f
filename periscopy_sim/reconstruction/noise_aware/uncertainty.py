"""How sure a penalized-likelihood estimate is of each patch."""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy import linalg, sparse

Array = NDArray[np.float64]

ROUNDING = 0.5
"""Where gradients are rounded off, over the prior's scale: of the values tried (0.5 to 4) the one
whose map agreed best with actual errors, in size and in place."""


def standard_errors(
    gram: Array, noise: Array, image: NDArray[np.floating[Any]], weight: float
) -> Array:
    """Approximate the posterior's standard deviations about a minimizer (Laplace's approximation).

    The misfit Σ ‖A⊥f_c − y⊥_c‖²/σ_c² is twice the negative logarithm of a likelihood, and λΣ‖∇f‖
    that of a prior. About f̂ the total variation is replaced by the quadratic function that touches
    it there, its gradients rounded off: ‖∇f‖ by ‖∇f‖²/(2√(‖∇f̂‖² + ε²)) and a constant, with
    ε = 2 `ROUNDING`/λ. What f ≥ 0 excludes, and errors of A and B, are left out of account.

    Parameters
    ----------
    gram
        (N, N) A⊥ᵀA⊥.
    noise
        (3,) σ_c.
    image
        (R, C, 3) f̂.
    weight
        λ > 0.

    Returns
    -------
    ndarray
        (R, C, 3), in units of the image.
    """
    rows, columns, _ = image.shape
    down = sparse.kron(_differences(rows), sparse.eye(columns)).tocsr()
    across = sparse.kron(sparse.eye(rows), _differences(columns)).tocsr()
    f = np.asarray(image, np.float64).reshape(-1, 3)
    squared = sum((np.asarray(d @ f) ** 2).sum(axis=1) for d in (down, across))
    precision = sparse.diags(weight / 2 / np.sqrt(squared + (2 * ROUNDING / weight) ** 2))
    prior = sum(d.T @ precision @ d for d in (down, across)).toarray()
    errors = np.empty_like(f)
    for channel, σ in enumerate(noise):
        curvature = gram / σ**2 + prior
        # A constant that no pixel shows is not known at all; a little keeps the factor finite.
        curvature[np.diag_indices_from(curvature)] += 1e-12 * np.trace(curvature) / len(curvature)
        factor, _ = linalg.lapack.dpotrf(curvature)
        inverse, _ = linalg.lapack.dpotri(factor)
        errors[:, channel] = np.sqrt(np.diag(inverse))
    return errors.reshape(image.shape)


def _differences(size: int) -> Any:
    """Forward differences, zero in the last place, (size, size)."""
    matrix = sparse.diags([-np.ones(size), np.ones(size - 1)], [0, 1], format="lil")
    matrix[size - 1, size - 1] = 0
    return matrix.tocsr()
