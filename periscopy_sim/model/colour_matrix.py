"""The colours of a monitor, as the channels of a camera see them."""

from dataclasses import dataclass

import numpy as np

from periscopy_sim.numerics import Array, Image

LARGEST_CONDITION = 100.0
"""Condition number from which a matrix no longer separates two primaries: real cameras have 2 to
10."""


@dataclass(frozen=True, eq=False)
class ColourMatrix:
    """M of y_j = Σ_k M_jk A f_k + B c_j + n_j, f_k in the monitor's primaries.

    Attributes
    ----------
    matrix
        (3, 3), the camera's channels down, the monitor's primaries across: column k is the colour
        that the camera sees where the monitor shows primary k alone.

    Raises
    ------
    ValueError
        If the matrix is not of 3 x 3 finite real numbers, or two primaries look alike.
    """

    matrix: Array

    def __post_init__(self) -> None:
        values = np.asarray(self.matrix)
        if values.shape != (3, 3) or values.dtype.kind not in "iuf":
            raise ValueError(
                f"a colour matrix is 3 x 3 real numbers, not of shape {values.shape} and type "
                f"{values.dtype}"
            )
        if not np.isfinite(values).all():
            raise ValueError("a colour matrix must be finite")
        if np.linalg.cond(values) > LARGEST_CONDITION:
            raise ValueError(
                "two primaries look alike to the camera: the colour matrix is nearly singular"
            )
        object.__setattr__(self, "matrix", values.astype(np.float64))

    def mix(self, light: Image) -> Array:
        """Return light in the camera's channels, (..., 3), from light in the primaries."""
        return np.asarray(light @ self.matrix.T, np.float64)

    def unmix(self, light: Image) -> Array:
        """Return light in the primaries, (..., 3), from light in the camera's channels."""
        return np.asarray(light @ np.linalg.inv(self.matrix).T, np.float64)
