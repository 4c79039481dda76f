"""An unknown, smooth gain over the wall, found from the photograph itself.

A lens darkens corners, a wall is not quite Lambertian, a monitor's fall-off with angle is fitted:
all that multiplies the penumbrae by something smooth, g = 1 + Σ_k c_k p_k, p_k polynomials over the
wall. A first image f₀ tells the few c_k: by least squares, from what neither A nor B explains,

    ĉ = argmin_c Σ_c' ‖(I − F Fᵀ)(y − Σ_k c_k p_k A f₀)_c'‖² / σ_c'²,   F a basis of [A, B].
"""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.polynomial import legendre
from numpy.typing import NDArray

Array = NDArray[np.float64]
Image = NDArray[np.floating[Any]]

BOUNDS = 0.2, 5.0
"""No gain is believed beyond these."""


class WallGain:
    """Estimate gains of one scene.

    Parameters
    ----------
    A
        (M, N) light transport matrix.
    Q
        (M, r) basis of the backgrounds.
    photograph_shape
        (rows, columns).
    degree
        Total degree of the polynomials.
    """

    def __init__(
        self, A: Image, Q: Array, photograph_shape: tuple[int, int], degree: int = 2
    ) -> None:
        self.A = np.asarray(A, np.float64)
        self._F = np.linalg.qr(np.hstack([Q, self.A]))[0]
        down, across = (legendre.legvander(np.linspace(-1, 1, n), degree) for n in photograph_shape)
        self.polynomials = np.stack(
            [
                np.outer(down[:, i], across[:, j]).ravel()
                for i in range(degree + 1)
                for j in range(degree + 1 - i)
                if i + j
            ],
            axis=1,
        )

    def estimate(self, photograph: Array, image: Array) -> Array:
        """Find the gain (M,) from a photograph (M, 3) and a first hidden image (N, 3)."""
        signal = self.A @ image
        left = self._unexplained(photograph)
        σ = np.sqrt(np.mean(left**2, axis=0))
        terms = [self._unexplained(self.polynomials * signal[:, [k]]) / σ[k] for k in range(3)]
        c = np.linalg.lstsq(np.vstack(terms), (left / σ).T.ravel())[0]
        gain: Array = np.clip(1 + self.polynomials @ c, *BOUNDS)
        return gain

    def _unexplained(self, columns: Array) -> Array:
        return np.asarray(columns - self._F @ (self._F.T @ columns))
