"""Least squares with total variation where A can only be passed over.

    f̂ = argmin_f ‖W (A⊥ f − y⊥)‖₂² + λ‖f‖_TV

One iteration is one pass over A for all columns of y together. The range of A⊥'s singular values
makes iterations many. The k strongest singular vectors are few and cheap to compute, once for
a scene (`TransportOperator.strongest_eigenvectors`). With them W = I − U (I − s Σ⁻¹) Uᵀ, U and Σ
the k strongest and s the least of them, lets no direction of the photograph weigh more than the
k-th. P, which is W with all the singular values equal, would let noise weigh as much as signal.
The k are measured so well that they lose nothing.

With total variation an iteration is an accelerated proximal gradient step, whose proximal operator
starts from the last one's dual field. The steps are longer than 1/L and the momentum is full until
it points uphill ("greedy FISTA"), which took two thirds of the iterations of FISTA with restarts on
the package's photographs.

References
----------
Beck, Teboulle, "A fast iterative shrinkage-thresholding algorithm for linear inverse problems",
2009.
Liang, Luo, Schönlieb, "Improving fast iterative shrinkage-thresholding algorithm: faster, smarter,
and greedier", 2022.
"""

from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np

from periscopy_sim.hidden import Hidden
from periscopy_sim.model.transport_operator import Eigenvectors, TransportOperator
from periscopy_sim.numerics import Array
from periscopy_sim.reconstruction.total_variation.prox import solve_total_variation

LONGEST_STEP, STEP_SHRINKAGE = 1.3, 0.96
"""First step times L; factor on the step, down to 1/L, where the image changes by more than at
first."""

PROXIMAL_ITERATIONS = 200
"""Most iterations of one proximal operator; the next operator starts from its result."""


@dataclass(frozen=True, eq=False)
class Iterate:
    """The last iterate: images f and G f, (N, K), of the quadratic fᵀG f."""

    f: Array
    product: Array
    path: Sequence[Array]
    """(K,) length of each iteration's change, as a fraction of the image's norm."""

    def path_of_last_third(self) -> float:
        """Return the longest path of an image over the last third of the iterations.

        The path is a fraction of the image's norm; it is infinite before six iterations.
        If the changes fall at least like 1/k², it bounds the remaining path up to a factor of 2.
        Here they fall exponentially: on photographs of the package, 25 to 60 dB, the remaining
        path was less than a tenth of it.
        """
        count = len(self.path)
        return float(np.sum(self.path[2 * count // 3 :], axis=0).max()) if count >= 6 else np.inf


@dataclass(frozen=True, eq=False)
class Weighed:
    """The quadratic ‖W A⊥ f‖², to be minimized with total variation."""

    transport: TransportOperator  # A⊥
    eigenvectors: Eigenvectors  # the k strongest of A⊥ᵀA⊥
    hidden: Hidden  # the surfaces that a column of f is on

    @property
    def lipschitz(self) -> float:
        """The energy of the k-th, with a margin for its error."""
        return 1.001 * float(self.eigenvectors.energy[-1])

    def product(self, f: Array) -> Array:
        """Multiply (N, K) by A⊥ᵀW²A⊥, in one pass."""
        V, energy = self.eigenvectors.V, self.eigenvectors.energy[:, None]
        return np.asarray(self.transport.gram_product(f) - V @ ((energy - energy[-1]) * (V.T @ f)))

    def data(self, h: Array) -> Array:
        """Return A⊥ᵀW² y⊥ from h = A⊥ᵀy⊥, (N, K)."""
        V, energy = self.eigenvectors.V, self.eigenvectors.energy[:, None]
        return np.asarray(h - V @ ((1 - energy[-1] / energy) * (V.T @ h)))

    def energy(self, y: Array, h: Array) -> Array:
        """Return ‖W y⊥‖², (K,), from y⊥ and h = A⊥ᵀy⊥."""
        V, energy = self.eigenvectors.V, self.eigenvectors.energy[:, None]
        less = (1 - energy[-1] / energy) * (V.T @ h) ** 2 / energy
        return np.asarray(np.sum(y**2, axis=0) - np.sum(less, axis=0))

    def start(self, h: Array) -> Array:
        """Return the least squares among the eigenvectors, for h = A⊥ᵀy⊥."""
        V, energy = self.eigenvectors.V, self.eigenvectors.energy[:, None]
        return np.asarray(V @ ((V.T @ h) / energy))

    def minimize(
        self,
        h: Array,
        weight: Callable[[Array, Array], Array],
        *,
        tolerance: float,
        max_iterations: int,
    ) -> Iterate:
        """Minimize ‖W (A⊥ f − y⊥)‖² + λ‖f‖_TV for each column of h = A⊥ᵀy⊥, (N, K).

        λ, (K,), follows from f and G f; a weight that grows with the misfit keeps the problem
        convex. The iterations stop when the path of the last third is at most the tolerance; the
        proximal operators' relative duality gap, which bounds a squared distance, is the hundredth
        part of the squared tolerance.
        """
        data, f = self.data(h), self.start(h)
        z, Gf = f, self.product(f)
        Gz, dual = Gf, None
        end, first = Iterate(f, Gf, []), np.full(h.shape[1], np.inf)
        reach = np.full(h.shape[1], LONGEST_STEP)
        while len(end.path) < max_iterations and end.path_of_last_third() > tolerance:
            step = reach / self.lipschitz
            proximal = solve_total_variation(
                z - step * (Gz - data),
                step * weight(f, Gf),
                self.hidden,
                tolerance=tolerance**2 / 100,
                max_iterations=PROXIMAL_ITERATIONS,
                start=dual,
            )
            previous, G_previous, dual = f, Gf, proximal.dual
            f = proximal.image
            Gf = self.product(f)
            length, size = (np.linalg.norm(each, axis=0) for each in (f - previous, f))
            first = first if end.path else length
            # 0 of a black channel, or of one that has converged to the last bit.
            fraction = np.divide(length, size, out=np.zeros_like(length), where=size > 0)
            end = Iterate(f, Gf, [*end.path, fraction])
            # The product with the next z follows from those with f by linearity.
            momentum = np.sum((z - f) * (f - previous), axis=0) <= 0  # or it points uphill
            reach = np.where(length > first, np.maximum(STEP_SHRINKAGE * reach, 1), reach)
            z = f + momentum * (f - previous)
            Gz = Gf + momentum * (Gf - G_previous)
        return end
