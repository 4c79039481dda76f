"""What a hidden image is estimated from: Gram matrix and data with the backgrounds projected out.

With A⊥ = A − Q QᵀA and y⊥ = y − Q Qᵀy, Q an orthonormal basis of range(B), the misfit of a channel
is ‖A⊥f − y⊥‖² = fᵀG f − 2 hᵀf + ‖y⊥‖², G = A⊥ᵀA⊥, h = A⊥ᵀy, here in units of the image in which G
has a mean diagonal of 1.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy import linalg

from experiments.beyond.regularizers import Problem

Array = NDArray[np.float64]
Image = NDArray[np.floating[Any]]

SEEN = 1e-12
"""Eigenvalues of G below this part of the largest are patterns that the wall does not show."""

NEIGHBOURS = np.array([[1, -2, 1], [-2, 4, -2], [1, -2, 1]]) / 6
"""High-pass filter of norm 1; light linear along rows or columns passes not (Immerkær 1996)."""


@dataclass(frozen=True, eq=False)
class Measured:
    """P photographs, reduced.

    Attributes
    ----------
    data
        h, (N, P, 3).
    energy
        ‖y⊥‖², (P, 3).
    noise
        σ of each channel, (P, 3).
    """

    data: Array
    energy: Array
    noise: Array

    def problem(self, regularization: float) -> Problem:
        """Weigh as `periscopy_sim.NoiseAware` does: λ = `regularization` ‖A⊥‖_F/σ̄, all times σ̄²."""
        mean = self.noise.mean(axis=1)
        weight = regularization * np.sqrt(len(self.data)) * mean / 2
        return Problem(self.data, (mean[:, None] / self.noise) ** 2, weight)


class NormalEquations:
    """A with a background's basis projected out.

    Parameters
    ----------
    A
        (M, N) light transport matrix.
    Q
        (M, r) orthonormal basis of the backgrounds.
    """

    def __init__(self, A: Image, Q: Array) -> None:
        self.A = np.asarray(A, np.float64)
        self.Q = Q
        self._overlap = Q.T @ self.A
        gram = self.A.T @ self.A - self._overlap.T @ self._overlap
        self.unit = float(np.sqrt(np.trace(gram) / len(gram)))
        """Of the image: one unit of it is 1 over this in units of the photograph over A's."""
        self.gram = gram / self.unit**2
        eigenvalues, vectors = linalg.eigh(self.gram)
        seen = eigenvalues > SEEN * eigenvalues[-1]
        self._eigenvalues, self._vectors = eigenvalues[seen], vectors[:, seen]

    @property
    def pixels(self) -> int:
        """Dimensions of a channel that the backgrounds leave."""
        return int(self.Q.shape[0] - self.Q.shape[1])

    def measured(self, photographs: Array) -> Measured:
        """Reduce (P, M, 3) photographs; σ is taken from what least squares leaves of them."""
        stills = len(photographs)
        y = np.moveaxis(photographs, 0, 1).reshape(self.Q.shape[0], -1)
        y = y - self.Q @ (self.Q.T @ y)
        energy = np.sum(y**2, axis=0)
        h = (self.A.T @ y) / self.unit
        explained = np.sum((self._vectors.T @ h) ** 2 / self._eigenvalues[:, None], axis=0)
        left = (energy - explained) / (self.pixels - len(self._eigenvalues))
        return Measured(
            h.reshape(len(h), stills, 3),
            energy.reshape(stills, 3),
            np.sqrt(np.maximum(left, 0)).reshape(stills, 3),
        )

    def whitened(self, measured: Measured) -> Measured:
        """Return P y in the place of h, G being the identity, and the mean noise of its patches."""
        inverse = (self._vectors / self._eigenvalues) @ self._vectors.T
        Py = np.einsum("ij,jpc->ipc", inverse, measured.data)
        gain = float(np.sqrt(np.trace(inverse) / len(inverse)))
        return Measured(Py, np.sum(Py**2, axis=0), gain * measured.noise)

    def misfit(self, measured: Measured, images: Array) -> Array:
        """Return ‖A⊥f − y⊥‖² of (N, P, 3) images: (P, 3)."""
        moved = np.einsum("ij,jpc->ipc", self.gram, images) - 2 * measured.data
        return np.asarray(measured.energy + np.sum(images * moved, axis=0))


def median_deviation(photographs: Array) -> Array:
    """Estimate σ from neighbouring pixels: the median of |high-passed| over that of the normal law.

    Parameters
    ----------
    photographs
        (P, rows, columns, 3).

    Returns
    -------
    ndarray
        (P, 3).
    """
    from scipy.ndimage import convolve
    from scipy.stats import norm

    passed = convolve(photographs, NEIGHBOURS[None, :, :, None])[:, 1:-1, 1:-1]
    σ: Array = np.median(np.abs(passed), axis=(1, 2)) / norm.ppf(0.75)
    return σ
