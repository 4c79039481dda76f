"""Numerics that rooms share: kinds of arrays, precision, threads, products, compiled loops."""

from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

Array = NDArray[np.float64]
Image = NDArray[np.floating[Any]]
Mask = NDArray[np.bool_]

SAMPLED_ROWS = 64
"""Rows looked at, about: of numbers in double precision, one of 2^29 is exact in single."""


def precision_of(values: ArrayLike) -> float:
    """Return ε of the floating-point type that a matrix was computed or stored in.

    Roundings to that type are independent: they move the singular values by less than ε times the
    largest one, whatever the shape. ε is that of the dtype, but that of float32 where a column of
    float64 is exact in single, not in half precision: such columns have been cast. The smooth
    fields of B have no more significant singular values beside ε: with B in float32, methods lose
    2 dB below that tolerance.
    """
    values = np.asarray(values)
    if values.dtype.kind != "f":
        return float(np.finfo(np.float64).eps)
    return float(np.finfo(np.float32 if cast_columns(values).any() else values.dtype).eps)


@np.errstate(over="ignore")
def cast_columns(values: NDArray[Any]) -> NDArray[np.bool_]:
    """Return which columns of float64 are exact in single, not in half precision: cast from it."""
    some = values[:: max(1, len(values) // SAMPLED_ROWS)]
    if values.dtype != np.float64:
        return np.zeros(some.shape[1:], bool)
    single, half = ((some == some.astype(t)).all(axis=0) for t in (np.float32, np.float16))
    return np.asarray(single & ~half)
