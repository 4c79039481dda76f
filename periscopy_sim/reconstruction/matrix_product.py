"""Products with a few vectors of a matrix too large for the cache, at the speed of memory.

BLAS packs the matrix anew for each product, which for three vectors costs more than the product.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from periscopy_sim.reconstruction.compiled import compiled_reordered
from periscopy_sim.reconstruction.threads import in_parallel, ranges

Array = NDArray[np.float32]

VECTORS = 3
"""Vectors that share one pass over the matrix: a photograph's channels."""

ROWS = 4
"""Rows read side by side, which keeps more of memory's requests under way than one alone."""


def times_matrix_transposed(vectors: Array, matrix: Array) -> Array:
    """Multiply vectors by the rows of a matrix: `vectors @ matrix.T`.

    Parameters
    ----------
    vectors
        (K, M) float32, C-contiguous.
    matrix
        (N, M) float32, C-contiguous.

    Returns
    -------
    ndarray
        (K, N) float32.
    """
    if len(vectors) != VECTORS or len(matrix) < ROWS:
        return np.asarray(vectors @ matrix.T)
    product = np.empty((len(vectors), len(matrix)), np.float32)
    blocks = ranges(len(matrix) // ROWS)

    def multiply(block: tuple[int, int]) -> None:
        start, stop = (ROWS * edge for edge in block)
        _multiply_rows(vectors, matrix, product, start, stop)

    in_parallel(multiply, blocks)
    # The last four rows again, if some are left over.
    _multiply_rows(vectors, matrix, product, len(matrix) - ROWS, len(matrix))
    return product


@compiled_reordered
def _multiply_rows(vectors: Array, matrix: Array, product: Array, start: int, stop: int) -> None:
    u, v, w = vectors[0], vectors[1], vectors[2]
    for row in range(start, stop, 4):
        a, b, c, d = matrix[row], matrix[row + 1], matrix[row + 2], matrix[row + 3]
        au = av = aw = bu = bv = bw = np.float32(0)
        cu = cv = cw = du = dv = dw = np.float32(0)
        for m in range(matrix.shape[1]):
            au += a[m] * u[m]
            av += a[m] * v[m]
            aw += a[m] * w[m]
            bu += b[m] * u[m]
            bv += b[m] * v[m]
            bw += b[m] * w[m]
            cu += c[m] * u[m]
            cv += c[m] * v[m]
            cw += c[m] * w[m]
            du += d[m] * u[m]
            dv += d[m] * v[m]
            dw += d[m] * w[m]
        product[0, row : row + 4] = au, bu, cu, du
        product[1, row : row + 4] = av, bv, cv, dv
        product[2, row : row + 4] = aw, bw, cw, dw
