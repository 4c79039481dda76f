"""Recovery without P: for hidden images so fine that P, or even A, does not fit in memory.

    f̂, σ = argmin_{f, σ} ‖W (A⊥ f − y⊥)‖₂² / σ + n σ + ω ‖A⊥‖_F ‖f‖_TV,   A⊥ = A − Q QᵀA

Q is an orthonormal basis of range(B), n = M − rank(B) − k is the number of values that contain
noise alone, and ω is `regularization`. The problem estimates noise and image together ("scaled" or
"square-root" lasso, Sun and Zhang 2012):

    σ² = ‖W (A⊥ f̂ − y⊥)‖² / n,   f̂ = argmin_f ‖W (A⊥ f − y⊥)‖₂² + λ‖f‖_TV,   λ = ω σ ‖A⊥‖_F

The objective is convex, so that the result depends on no start and on no intermediate decision.

Without the total variation this is P y (Eq. 8), since P is the pseudoinverse of A⊥. The paper
applies total variation to P y instead (Eq. 10), which assumes that its noise is white. Where P y is
nearly all noise, as on fine grids, the problem above is the one that is well posed.

The range of A⊥'s singular values makes iterations many. The k strongest singular vectors are few
and cheap to compute, once for a scene. With them W = I − U (I − s Σ⁻¹) Uᵀ, U and Σ the k strongest
and s the least of them, lets no direction of the photograph weigh more than the k-th. P, which is W
with all the singular values equal, would let noise weigh as much as signal. The k are measured so
well that they lose nothing.

One iteration is an accelerated proximal gradient step (Beck and Teboulle 2009) and one pass over A
for all columns of y together. Its proximal operator starts from the last one's dual field. The
steps are longer than 1/L and the momentum is full until it points uphill ("greedy FISTA"), which
took two thirds of the iterations of FISTA with restarts on the package's photographs.

References
----------
Sun, Zhang, "Scaled sparse linear regression", 2012.
Beck, Teboulle, "A fast iterative shrinkage-thresholding algorithm for linear inverse problems",
2009.
Liang, Luo, Schönlieb, "Improving fast iterative shrinkage-thresholding algorithm: faster, smarter,
and greedier", 2022.
"""

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from functools import cached_property
from typing import Any

import numpy as np

from periscopy_sim.hidden import Hidden
from periscopy_sim.model.noise import residual_noise
from periscopy_sim.model.transport_operator import Matrix, TransportOperator
from periscopy_sim.numerics import Array, Image
from periscopy_sim.numerics.validation import InputError, check_stopping, warn_unconverged
from periscopy_sim.reconstruction.method import Solution, StillMethod, of_all
from periscopy_sim.reconstruction.total_variation.prox import solve_total_variation

EIGENVECTORS = 60
"""Eigenvectors of A⊥ᵀA⊥, computed once for a scene; of few patches an eighth."""

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
    hidden: Hidden  # the surfaces that a column of f is on
    strengths: Array  # (k,) the largest eigenvalues of A⊥ᵀA⊥, in falling order
    V: Array  # (N, k) their eigenvectors

    @property
    def lipschitz(self) -> float:
        """The energy of the k-th, with a margin for its error."""
        return 1.001 * float(self.strengths[-1])

    @property
    def _excess(self) -> Array:
        """I − s² Σ⁻², (k, 1): the fraction of each direction's energy that W takes."""
        return np.asarray(1 - self.strengths[-1] / self.strengths)[:, None]

    def product(self, f: Array) -> Array:
        """Multiply (N, K) by A⊥ᵀW²A⊥, in one pass."""
        less = self.strengths[:, None] * self._excess * (self.V.T @ f)
        return np.asarray(self.transport.gram_product(f) - self.V @ less)

    def data(self, h: Array) -> Array:
        """Return A⊥ᵀW² y⊥ from h = A⊥ᵀy⊥, (N, K)."""
        return np.asarray(h - self.V @ (self._excess * (self.V.T @ h)))

    def energy(self, y: Array, h: Array) -> Array:
        """Return ‖W y⊥‖², (K,), from y⊥ and h = A⊥ᵀy⊥."""
        less = self._excess * (self.V.T @ h) ** 2 / self.strengths[:, None]
        return np.asarray(np.sum(y**2, axis=0) - np.sum(less, axis=0))

    def start(self, h: Array) -> Array:
        """Return the least squares among the eigenvectors, for h = A⊥ᵀy⊥."""
        return np.asarray(self.V @ ((self.V.T @ h) / self.strengths[:, None]))

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


@dataclass(frozen=True, eq=False, repr=False)
class IterativeReconstruction(Solution[np.float64]):
    """A hidden image and how the iterations ended; see `Solution`.

    Attributes
    ----------
    iterations
        Number of iterations; each is a pass over A.
    change
        Path of the image over the last third of them, as a fraction of its norm; see
        `Iterate.path_of_last_third`.
    converged
        Whether the change is within the tolerance.
    """

    iterations: int
    change: float
    converged: bool

    def numbers(self) -> dict[str, Any]:
        """Return the noise, the weights, the iterations and the last change."""
        return {**super().numbers(), "iterations": self.iterations, "change": self.change}


class IterativePeriscope(StillMethod[np.float64]):
    """The paper's problem solved by iterations, without P and without an N x N matrix.

    Fitting to a scene takes one pass over A, and some 120 with the first photograph for the
    `EIGENVECTORS` that the wall shows best. Each photograph then takes accelerated proximal
    gradient steps: some 45 passes where there is much noise, up to 190 where there is little. λ
    follows a photograph's noise and units, and fits any grid: where patches are halved, ‖A⊥‖_F
    halves, and ‖f‖_TV of one image doubles.

    Parameters
    ----------
    A
        (M, N) light transport matrix: an array, a memory map, or `RowBlocks`. For photographs with
        a mask, the rows used are copied into memory.
    regularization
        λ over σ ‖A⊥‖_F, a number without unit, as in `NoiseAware`.
    tolerance
        Stop where the image's way in the last third of the iterations is at most this part of its
        norm. It was then within a tenth of that of the minimum.
    max_iterations
        Stop after so many, with a warning.
    B, **scene
        As of `StillMethod`, whose other errors it raises, too.
    """

    def __init__(
        self,
        A: Matrix,
        B: Image | None = None,
        *,
        regularization: float = 0.015,
        tolerance: float = 1e-3,
        max_iterations: int = 1000,
        **scene: Any,
    ) -> None:
        super().__init__(A, B, **scene)
        if not 0 < regularization < np.inf:
            raise InputError(f"regularization is {regularization}: give a positive, finite number")
        check_stopping(tolerance, max_iterations)
        self.regularization = regularization
        self.tolerance = tolerance
        self.max_iterations = max_iterations

    def prepare(self) -> None:
        """Pass over A, and see that the pixels determine the patches; see `StillMethod`."""
        (pixels, patches), rank = self.fit.operator.shape, self.fit.basis.shape[1]
        if rank + patches > pixels:
            raise InputError(
                f"{pixels} pixels do not determine {patches} patches beside {rank} patterns of "
                "ambient light; use more pixels, or fewer patches or backgrounds"
            )

    @of_all
    def solve(self, photograph: Image) -> IterativeReconstruction:
        """Recover the hidden image, with the state of the iterations; see `reconstruct`."""
        self.prepare()
        transport = self.fit.operator
        y = transport.project_out(self.fit.vectors(photograph))
        problem = Weighed(transport, self.hidden, *self.eigenvectors)
        h = transport.rmatmat(y)
        data, energy = problem.data(h), problem.energy(y, h)
        pixels, rank = transport.Q.shape
        freedom = pixels - rank - len(problem.strengths)

        def noise_of(f: Array, product: Array) -> Array:
            return residual_noise(energy, np.sum(f * (2 * data - product), axis=0), freedom)

        end = problem.minimize(
            h,
            lambda f, product: self._weight(noise_of(f, product)),
            tolerance=self.tolerance,
            max_iterations=self.max_iterations,
        )
        noise = noise_of(end.f, end.product)
        iterations, change = len(end.path), end.path_of_last_third()
        warn_unconverged("iterative recovery", iterations, change, self.tolerance)
        image, state = self.hidden.image(end.f), (iterations, change, change <= self.tolerance)
        return IterativeReconstruction(image, noise, self._weight(noise), *state)

    @cached_property
    def eigenvectors(self) -> tuple[Array, Array]:
        """The strongest eigenvalues and eigenvectors of A⊥ᵀA⊥."""
        count = max(min(EIGENVECTORS, self.hidden.patches // 8), 1)
        return self.fit.operator.strongest_eigenvectors(count)

    def _weight(self, noise: Array) -> Array:
        return np.asarray(self.regularization * noise * np.sqrt(self.fit.operator.squared_norm))
