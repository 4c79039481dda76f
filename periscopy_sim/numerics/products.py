"""Compiled loops, and products of photographs with large matrices at the speed of memory.

For the three channels of one photograph BLAS packs the matrix anew, which costs more than the
product, and its threads then spin for milliseconds on the cores that the next stage needs: a still
by the noise-aware method took half as long again, and the frames of a video twice as long.
"""

from collections.abc import Callable
from itertools import pairwise
from typing import Any, TypeVar

import numba
import numpy as np

from periscopy_sim.numerics import Image, machine

Function = TypeVar("Function", bound=Callable[..., Any])


def compiled(function: Function, **options: Any) -> Function:
    """Compile a function; divisions by zero give infinity or NaN, as in NumPy.

    Loops compile in a third of the time of copied slices, sorts and NumPy's reductions.
    """
    settings = {"nogil": True, "error_model": "numpy", **options}
    try:
        result: Function = numba.njit(cache=True, **settings)(function)
    except RuntimeError:  # no folder takes the cache: each process compiles anew
        result = numba.njit(**settings)(function)
    return result


def compiled_reordered(function: Function) -> Function:
    """Compile a function of finite numbers whose sums may be reordered, so that loops vectorize."""
    return compiled(function, fastmath={"reassoc", "nsz", "nnan", "contract"})


CHUNK, TILE = 1024, 48
"""Columns, about, and rows at a time, which stay in the cache for all vectors."""

LARGE = 2**20
"""Entries of a matrix above which a second thread for its other half is worth while."""


def times_rows(vectors: Image, matrix: Image) -> Image:
    """Multiply vectors by the rows of a matrix: `vectors @ matrix.T`, (K, N), of the vectors' type.

    The vectors, (K, M), and the matrix, (N, M) of the same type or a narrower one, are
    C-contiguous; the loops want K to be a multiple of 3. A photograph's products do not depend on
    how many others there are.
    """
    if len(vectors) % 3:
        return np.asarray(vectors @ matrix.T)
    product = np.zeros((len(vectors), len(matrix)), vectors.dtype)
    blocks = machine.ranges(-(-len(matrix) // 4))
    machine.in_parallel(lambda part: _multiply(vectors, matrix, *part, product), blocks)
    return product


@compiled_reordered
def _multiply(vectors: Image, matrix: Image, start: int, stop: int, product: Image) -> None:
    """Add the products of blocks of four rows, three vectors at a time.

    Four rows read side by side keep more of memory's requests under way than one alone. Past the
    last row that row stands in for those that are missing.
    """
    count, columns = matrix.shape
    end = min(4 * stop, count)
    tiles = [
        (first, top) for first in range(0, columns, CHUNK) for top in range(4 * start, end, TILE)
    ]
    for first, top in tiles:
        last = min(first + CHUNK, columns)
        for k in range(0, len(vectors), 3):
            u, v = vectors[k, first:last], vectors[k + 1, first:last]
            w = vectors[k + 2, first:last]
            for row in range(top, min(top + TILE, end), 4):
                a, b = matrix[row, first:last], matrix[min(row + 1, count - 1), first:last]
                c = matrix[min(row + 2, count - 1), first:last]
                d = matrix[min(row + 3, count - 1), first:last]
                au = av = aw = bu = bv = bw = product.dtype.type(0)
                cu = cv = cw = du = dv = dw = product.dtype.type(0)
                for m in range(last - first):
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
                    for r in range(min(4, count - row)):
                        product[k + n, row + r] += sums[n][r]


def subtract_combinations(vectors: Image, coefficients: Image, rows: Image) -> None:
    """Subtract combinations of rows from vectors, in place: `vectors -= coefficients @ rows`.

    The shapes are (K, M), (K, r) and (r, M), of one type, the vectors C-contiguous.
    """
    chunks = machine.ranges(-(-rows.shape[1] // CHUNK))
    machine.in_parallel(lambda part: _subtract(vectors, coefficients, rows, *part), chunks)


@compiled_reordered
def _subtract(vectors: Image, coefficients: Image, rows: Image, start: int, stop: int) -> None:
    """Subtract four rows at a time, so that vectors are read and written for every fourth alone."""
    count = len(rows)
    zero = coefficients.dtype.type(0)
    for first in range(CHUNK * start, min(CHUNK * stop, rows.shape[1]), CHUNK):
        last = min(first + CHUNK, rows.shape[1])
        for r in range(0, count, 4):
            s, t, u = min(r + 1, count - 1), min(r + 2, count - 1), min(r + 3, count - 1)
            a, b = rows[r, first:last], rows[s, first:last]
            c, d = rows[t, first:last], rows[u, first:last]
            for k in range(len(vectors)):
                v, x = vectors[k, first:last], coefficients[k, r]
                y = coefficients[k, s] if s > r else zero
                z = coefficients[k, t] if t > s else zero
                w = coefficients[k, u] if u > t else zero
                for m in range(last - first):
                    v[m] -= x * a[m] + y * b[m] + z * c[m] + w * d[m]


def combine_rows(coefficients: Image, rows: Image) -> Image:
    """Combine rows: `coefficients @ rows`, (K, M), of one type."""
    combined = np.zeros((len(coefficients), rows.shape[1]), rows.dtype)
    subtract_combinations(combined, -coefficients, rows)
    return combined


def project_out(vectors: Image, basis: Image) -> Image:
    """Return vectors, (K, M), with the span of orthonormal rows, (r, M), projected out."""
    projected = np.array(vectors, np.result_type(vectors, basis), order="C")
    subtract_combinations(projected, times_rows(projected, basis), basis)
    return projected


def filter_rows(vectors: Image, rows: Image, gain: Image, offset: Image) -> Image:
    """Return filtered products with rows, (K, N): `(gain * (vectors @ rows.T) + offset) @ rows`.

    The vectors are (K, N), the rows (r, N), gain and offset (K, r), of one type and C-contiguous.
    Each row is read once for both products, a third of BLAS's time.
    """
    edges = (0, len(rows) // 2, len(rows)) if rows.size > LARGE else (0, len(rows))

    def filtered(part: tuple[int, int]) -> Image:
        combined, own = np.zeros_like(vectors), slice(*part)
        _filter(vectors, rows[own], gain[:, own], offset[:, own], combined)
        return combined

    first, *others = machine.in_parallel(filtered, [*pairwise(edges)])
    for each in others:
        first += each
    return first


@compiled_reordered
def _filter(vectors: Image, rows: Image, gain: Image, offset: Image, combined: Image) -> None:
    count, columns = rows.shape
    for r in range(0, count, 2):  # two rows side by side save a sixth of the time
        p, q = rows[r], rows[min(r + 1, count - 1)]
        for k in range(len(vectors)):
            v, result = vectors[k], combined[k]
            a = b = combined.dtype.type(0)
            for n in range(columns):
                a += p[n] * v[n]
                b += q[n] * v[n]
            a = gain[k, r] * a + offset[k, r]
            b = gain[k, r + 1] * b + offset[k, r + 1] if r + 1 < count else b * 0
            for n in range(columns):
                result[n] += a * p[n] + b * q[n]
