"""Eq. 3: the matrix D of [15], which takes differences between neighbouring pixels."""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray


def neighbour_differences(
    A: NDArray[np.floating[Any]], photograph_shape: tuple[int, int], *, wrap: bool = True
) -> NDArray[np.floating[Any]]:
    """Apply the D of Eq. 3 to the rows of A.

    The published code of [15] vectorizes the photograph by columns, so that neighbours lie one
    below the other, takes differences across the ends of columns too, and keeps the last pixel as
    it is: its D is square, and the last row lets the background through.

    Parameters
    ----------
    A
        (M, N), or (M,) for one photograph; row-major.
    photograph_shape
        (rows, columns) with product M.
    wrap
        Whether to do as the published code does; otherwise only differences within the columns of
        the photograph are taken, (rows - 1) x columns of them.

    Returns
    -------
    ndarray
        D A, (M, N), or ((rows - 1) columns, N) without wrapping, or the same for one photograph;
        in column-major order of the photograph.

    Raises
    ------
    ValueError
        If A has not as many rows as the photograph has pixels.
    """
    rows, columns = photograph_shape
    if len(A) != rows * columns:
        raise ValueError(
            f"a photograph of {rows}x{columns} pixels does not fit the {len(A)} rows of A"
        )
    by_columns = A.reshape(rows, columns, *A.shape[1:]).swapaxes(0, 1)
    if not wrap:
        return np.diff(by_columns, axis=1).reshape(-1, *A.shape[1:])
    differences: NDArray[np.floating[Any]] = by_columns.reshape(A.shape).copy()
    differences[:-1] = differences[1:] - differences[:-1]
    return differences
