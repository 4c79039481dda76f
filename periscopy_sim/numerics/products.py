"""Products of photographs with large matrices, at the speed of memory or of the cores.

For the three channels of one photograph BLAS packs the matrix anew, which costs more than the
product, and its threads then spin for milliseconds on the cores that the next stage needs. Sums
over all pixels that make few numbers are worst: the threads wait for each other many times over,
and on a busy machine each time until the other one has its turn.
"""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray

from periscopy_sim.numerics.compilation import compiled_reordered
from periscopy_sim.numerics.threads import in_parallel, ranges

Array = NDArray[Any]

VECTORS = 3
"""Vectors taken together, a photograph's channels; the loops below name them."""

ROWS = 4
"""Rows read side by side, which keeps more of memory's requests under way than one alone."""

CHUNK = 1024
"""Columns at a time: with many vectors, theirs and the rows' then stay in the cache."""

SMALL = 1 << 20
"""Entries of a matrix below which waking threads takes longer than the product."""


def times_rows(vectors: Array, matrix: Array, *, upper: bool = False) -> Array:
    """Multiply vectors by the rows of a matrix: `vectors @ matrix.T`, (K, N), of the vectors' type.

    The vectors, (K, M), and the matrix, (N, M) of the same type or a narrower one, are
    C-contiguous; the loops want K to be a multiple of 3. Of an `upper` triangular matrix, the half
    left of the diagonal is skipped.
    """
    if len(vectors) % VECTORS:
        return np.asarray(vectors @ matrix.T)
    product = np.zeros((len(vectors), len(matrix)), vectors.dtype)
    blocks = len(matrix) // ROWS

    def multiply(block: tuple[int, int]) -> None:
        start, stop = (ROWS * edge for edge in block)
        _multiply(vectors, matrix, upper, start, stop, product)

    if matrix.size < SMALL:
        multiply((0, blocks))
    else:
        in_parallel(multiply, ranges(blocks))
    rest = matrix[ROWS * blocks :]
    if len(rest):  # of a number of rows that is no multiple of four
        padded = np.zeros((ROWS, matrix.shape[1]), matrix.dtype)
        padded[: len(rest)] = rest
        last = np.zeros((len(vectors), ROWS), vectors.dtype)
        _multiply(vectors, padded, False, 0, ROWS, last)
        product[:, ROWS * blocks :] = last[:, : len(rest)]
    return product


@compiled_reordered
def _multiply(
    vectors: Array,
    matrix: Array,
    upper: bool,
    start: int,
    stop: int,
    product: Array,
) -> None:
    """Add the products with four rows at a time.

    Each sum runs over the same chunks in the same order, whichever loop is the outer one, so that
    a photograph's products do not depend on how many others there are.
    """
    columns = matrix.shape[1]
    if len(vectors) == 3:  # memory is read in order
        for row in range(start, stop, 4):
            for first in range(row // CHUNK * CHUNK if upper else 0, columns, CHUNK):
                _add_chunk(vectors, matrix, upper, row, first, product)
    else:  # chunks of all vectors stay in the cache
        for first in range(0, columns, CHUNK):
            for row in range(start, stop, 4):
                _add_chunk(vectors, matrix, upper, row, first, product)


@compiled_reordered
def _add_chunk(
    vectors: Array, matrix: Array, upper: bool, row: int, first: int, product: Array
) -> None:
    """Add the products of one chunk of four rows, with three vectors at a time."""
    last = min(first + CHUNK, matrix.shape[1])
    left = max(first, row) if upper else first
    if left >= last:
        return
    a, b = matrix[row, left:last], matrix[row + 1, left:last]
    c, d = matrix[row + 2, left:last], matrix[row + 3, left:last]
    for k in range(0, len(vectors), 3):
        u = vectors[k, left:last]
        v = vectors[k + 1, left:last]
        w = vectors[k + 2, left:last]
        au = av = aw = bu = bv = bw = product.dtype.type(0)
        cu = cv = cw = du = dv = dw = product.dtype.type(0)
        for m in range(last - left):
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
        sums = ((au, bu, cu, du), (av, bv, cv, dv), (aw, bw, cw, dw))
        for n in range(3):
            for r in range(4):
                product[k + n, row + r] += sums[n][r]


def subtract_combinations(vectors: Array, coefficients: Array, rows: Array) -> None:
    """Subtract combinations of rows from vectors, in place: `vectors -= coefficients @ rows`.

    The shapes are (K, M), (K, r) and (r, M), of one type, the vectors C-contiguous.
    """
    chunks = -(-rows.shape[1] // CHUNK)

    def subtract(part: tuple[int, int]) -> None:
        _subtract(vectors, coefficients, rows, *part)

    if rows.size < SMALL:
        subtract((0, chunks))
    else:
        in_parallel(subtract, ranges(chunks))


@compiled_reordered
def _subtract(vectors: Array, coefficients: Array, rows: Array, start: int, stop: int) -> None:
    columns = vectors.shape[1]
    for chunk in range(start, stop):
        first, last = CHUNK * chunk, min(CHUNK * (chunk + 1), columns)
        for k in range(len(vectors)):
            v = vectors[k, first:last]
            whole = len(rows) // 4 * 4
            for r in range(0, whole, 4):
                a, b = coefficients[k, r], coefficients[k, r + 1]
                c, d = coefficients[k, r + 2], coefficients[k, r + 3]
                p, q = rows[r, first:last], rows[r + 1, first:last]
                s, t = rows[r + 2, first:last], rows[r + 3, first:last]
                for m in range(last - first):
                    v[m] -= a * p[m] + b * q[m] + c * s[m] + d * t[m]
            for r in range(whole, len(rows)):
                a, p = coefficients[k, r], rows[r, first:last]
                for m in range(last - first):
                    v[m] -= a * p[m]


def combine_rows(coefficients: Array, rows: Array) -> Array:
    """Combine rows: `coefficients @ rows`, (K, M), of one type."""
    combined = np.zeros((len(coefficients), rows.shape[1]), rows.dtype)
    subtract_combinations(combined, -coefficients, rows)
    return combined


def project_out(vectors: Array, basis: Array) -> Array:
    """Return vectors, (K, M), with the span of orthonormal rows, (r, M), projected out."""
    projected = np.array(vectors, np.result_type(vectors, basis), order="C")
    subtract_combinations(projected, times_rows(projected, basis), basis)
    return projected


def filter_rows(vectors: Array, rows: Array, gain: Array, offset: Array) -> Array:
    """Return filtered products with rows, (K, N): `(gain * (vectors @ rows.T) + offset) @ rows`.

    The vectors are (K, N), the rows (r, N), gain and offset (K, r), of one type and C-contiguous.
    Each row is read once for both products, which memory is too slow to read twice.
    """
    combined = np.zeros_like(vectors)
    _filter(vectors, rows, gain, offset, combined)
    return combined


@compiled_reordered
def _filter(vectors: Array, rows: Array, gain: Array, offset: Array, combined: Array) -> None:
    columns = rows.shape[1]
    whole = len(rows) // 4 * 4
    for r in range(0, whole, 4):
        p, q, s, t = rows[r], rows[r + 1], rows[r + 2], rows[r + 3]
        for k in range(len(vectors)):
            v, result = vectors[k], combined[k]
            a = b = c = d = combined.dtype.type(0)
            for n in range(columns):
                a += p[n] * v[n]
                b += q[n] * v[n]
                c += s[n] * v[n]
                d += t[n] * v[n]
            a, b = gain[k, r] * a + offset[k, r], gain[k, r + 1] * b + offset[k, r + 1]
            c, d = gain[k, r + 2] * c + offset[k, r + 2], gain[k, r + 3] * d + offset[k, r + 3]
            for n in range(columns):
                result[n] += a * p[n] + b * q[n] + c * s[n] + d * t[n]
    for r in range(whole, len(rows)):
        p = rows[r]
        for k in range(len(vectors)):
            v, result = vectors[k], combined[k]
            a = combined.dtype.type(0)
            for n in range(columns):
                a += p[n] * v[n]
            a = gain[k, r] * a + offset[k, r]
            for n in range(columns):
                result[n] += a * p[n]
