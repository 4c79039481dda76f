"""Eq. 3: the matrix D of [15], which takes differences between neighbouring pixels."""

import numpy as np
from numpy.typing import NDArray

from periscopy_sim.reconstruction.method import Precision


def neighbour_differences(
    A: NDArray[Precision],
    photograph_shape: tuple[int, int],
    *,
    wrap: bool = True,
    mask: NDArray[np.bool_] | None = None,
) -> NDArray[Precision]:
    """Apply the D of Eq. 3 to the rows of A, (M, N), or to one photograph, (M,); row-major.

    The published code of [15] vectorizes the photograph by columns, so that neighbours lie one
    below the other, takes differences across the ends of columns too, and keeps the last pixel as
    it is: its D is square, (M, M), and the last row lets the background through. Without `wrap`
    only the (rows − 1) x columns differences within columns are taken. D A is in column-major
    order.

    With a mask, (rows, columns), A has the M' rows used alone. A difference then counts only if
    both its pixels are used, and the last pixel if it is; only the rows that count are returned.
    """
    rows, columns = photograph_shape
    pixels = rows * columns if mask is None else np.count_nonzero(mask)
    if len(A) != pixels:
        raise ValueError(
            f"a photograph of {rows}x{columns} pixels does not fit the {len(A)} rows of A"
        )
    if mask is not None:
        whole = np.zeros((rows * columns, *A.shape[1:]), A.dtype)
        whole[np.ravel(mask)] = A
        differences = neighbour_differences(whole, photograph_shape, wrap=wrap)
        return differences[_both_used(np.reshape(mask, photograph_shape), wrap)]
    by_columns = A.reshape(rows, columns, *A.shape[1:]).swapaxes(0, 1)
    if not wrap:
        return np.diff(by_columns, axis=1).reshape(-1, *A.shape[1:])
    wrapped = by_columns.reshape(A.shape).copy()
    wrapped[:-1] = wrapped[1:] - wrapped[:-1]
    return wrapped


def _both_used(mask: NDArray[np.bool_], wrap: bool) -> NDArray[np.bool_]:
    """Return which rows of D meet used pixels only."""
    by_columns = mask.T
    if not wrap:
        return (by_columns[:, 1:] & by_columns[:, :-1]).ravel()
    both = by_columns.flatten()
    both[:-1] &= both[1:]  # the last pixel stands alone
    return both
