"""Eq. 3: the matrix D of [15], which takes differences between neighbouring pixels."""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray


def neighbour_differences(
    A: NDArray[np.floating[Any]],
    photograph_shape: tuple[int, int],
    *,
    wrap: bool = True,
    mask: NDArray[np.bool_] | None = None,
) -> NDArray[np.floating[Any]]:
    """Apply the D of Eq. 3 to the rows of A.

    The published code of [15] vectorizes the photograph by columns, so that neighbours lie one
    below the other, takes differences across the ends of columns too, and keeps the last pixel as
    it is: its D is square, and the last row lets the background through.

    Parameters
    ----------
    A
        (M, N), or (M,) for one photograph; row-major. With a mask the rows used alone, (M', N).
    photograph_shape
        (rows, columns) with product M.
    wrap
        Whether to do as the published code does; otherwise only differences within the columns of
        the photograph are taken, (rows - 1) x columns of them.
    mask
        (rows, columns), True in the M' pixels that are used; None for all. A difference counts only
        if both its pixels are used, and the last pixel if it is.

    Returns
    -------
    ndarray
        D A, (M, N), or ((rows - 1) columns, N) without wrapping, or the same for one photograph;
        in column-major order of the photograph. With a mask only the rows that count.

    Raises
    ------
    ValueError
        If A has not as many rows as the photograph has pixels, or the mask leaves.
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
    wrapped: NDArray[np.floating[Any]] = by_columns.reshape(A.shape).copy()
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
