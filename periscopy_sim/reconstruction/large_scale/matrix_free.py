"""Least squares where A can only be passed over: as they are, and weighed for total variation.

One iteration is one pass over A for all columns of y together. What makes iterations many is the
range of A⊥'s singular values. Its k strongest singular vectors are few and cheap to find, once for
a scene (`TransportOperator.strongest_eigenvectors`). With them W = I − U (I − s Σ⁻¹) Uᵀ, U and Σ
the k strongest and s the least of them, lets no direction of the photograph weigh more than the
k-th. P, which is W with all the singular values equal, would let noise weigh as much as signal.
The k are measured so well that they lose nothing.

References
----------
Hestenes, Stiefel, "Methods of conjugate gradients for solving linear systems", 1952.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from periscopy_sim.model.transport_operator import (
    Eigenvectors,
    TransportOperator,
)
from periscopy_sim.reconstruction.total_variation.least_squares import (
    Iterate,
    path_of_last_third,
    ratio,
)

Array = NDArray[np.float64]
Image = NDArray[np.floating[Any]]


def least_squares(
    transport: TransportOperator, h: Array, *, tolerance: float, max_iterations: int
) -> Iterate:
    """Minimize ‖A⊥f − y⊥‖² by conjugate gradients on the normal equations, h = A⊥ᵀy⊥, (N, K).

    Each column is a problem of its own; all share the passes. They stop when `path_of_last_third`
    is at most the tolerance.
    """
    f, descent, direction = np.zeros_like(h), h.copy(), h.copy()
    slope = np.sum(descent**2, axis=0)
    path: list[Array] = []
    iterate = Iterate(f, h - descent, descent, 0, path, np.inf)
    while len(path) < max_iterations and iterate.error > tolerance:
        image = transport.gram_product(direction)
        step = ratio(slope, np.sum(direction * image, axis=0))
        f = f + step * direction
        descent = descent - step * image
        path.append(ratio(step * np.linalg.norm(direction, axis=0), np.linalg.norm(f, axis=0)))
        previous, slope = slope, np.sum(descent**2, axis=0)
        direction = descent + ratio(slope, previous) * direction
        iterate = Iterate(f, h - descent, descent, len(path), path, np.inf)
        iterate = replace(iterate, error=path_of_last_third(iterate))
    return iterate


@dataclass(frozen=True, eq=False)
class Weighed:
    """The quadratic ‖W A⊥ f‖², to be minimized with total variation."""

    transport: TransportOperator  # A⊥
    eigenvectors: Eigenvectors  # the k strongest of A⊥ᵀA⊥
    image_shape: tuple[int, int]  # (R, C) of a column of f

    @property
    def lipschitz(self) -> float:
        """The energy of the k-th, with a margin for its error."""
        return 1.001 * float(self.eigenvectors.energy[-1])

    def product(self, f: Array) -> Array:
        """Multiply (N, K) by A⊥ᵀW²A⊥, in one pass."""
        V, energy = self.eigenvectors.V, self.eigenvectors.energy[:, None]
        product: Array = self.transport.gram_product(f) - V @ ((energy - energy[-1]) * (V.T @ f))
        return product

    def data(self, h: Array) -> Array:
        """Return A⊥ᵀW² y⊥ from h = A⊥ᵀy⊥, (N, K)."""
        V, energy = self.eigenvectors.V, self.eigenvectors.energy[:, None]
        weighed: Array = h - V @ ((1 - energy[-1] / energy) * (V.T @ h))
        return weighed

    def energy(self, y: Array, h: Array) -> Array:
        """Return ‖W y⊥‖², (K,), from y⊥ and h = A⊥ᵀy⊥."""
        V, energy = self.eigenvectors.V, self.eigenvectors.energy[:, None]
        less = (1 - energy[-1] / energy) * (V.T @ h) ** 2 / energy
        left: Array = np.sum(y**2, axis=0) - np.sum(less, axis=0)
        return left

    def start(self, h: Array) -> Array:
        """Return the least squares among the eigenvectors, for h = A⊥ᵀy⊥."""
        V, energy = self.eigenvectors.V, self.eigenvectors.energy[:, None]
        image: Array = V @ ((V.T @ h) / energy)
        return image
