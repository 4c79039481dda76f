"""Recovery without P: for hidden images so fine that P, or even A, does not fit in memory.

    f̂, σ = argmin_{f, σ} ‖W (A⊥ f − y⊥)‖₂² / σ + n σ + ω ‖A⊥‖_F ‖f‖_TV,   A⊥ = A − Q QᵀA

Q is an orthonormal basis of range(B), W weighs the k eigenvectors that the wall shows best down
(see `matrix_free`), n = M − rank(B) − k is the number of values that contain noise alone, and ω is
`regularization`. The problem estimates noise and image together ("scaled" or "square-root" lasso):

    σ² = ‖W (A⊥ f̂ − y⊥)‖² / n,   f̂ = argmin_f ‖W (A⊥ f − y⊥)‖₂² + λ‖f‖_TV,   λ = ω σ ‖A⊥‖_F

The objective is convex, so that the result depends on no start and on no intermediate decision.

Without the total variation this is P y (Eq. 8), since P is the pseudoinverse of A⊥. The paper
applies total variation to P y instead (Eq. 10), which assumes that its noise is white. Where P y is
nearly all noise, as on fine grids, the problem above is the one that is well posed.

References
----------
Sun, Zhang, "Scaled sparse linear regression", 2012.
"""

from dataclasses import dataclass
from functools import cached_property
from typing import Any

import numpy as np

from periscopy_sim.model.noise import residual_noise
from periscopy_sim.model.transport_operator import Eigenvectors, Matrix
from periscopy_sim.numerics import Array, Image
from periscopy_sim.numerics.validation import InputError, check_stopping, warn_unconverged
from periscopy_sim.reconstruction.large_scale.matrix_free import Weighed
from periscopy_sim.reconstruction.method import Solution, StillMethod, of_all

EIGENVECTORS = 60
"""Eigenvectors of A⊥ᵀA⊥, computed once for a scene; of few patches an eighth. See `matrix_free`."""


@dataclass(frozen=True, eq=False, repr=False)
class IterativeReconstruction(Solution[np.float64]):
    """A hidden image and how the iterations ended; see `Solution`.

    Attributes
    ----------
    iterations
        Number of iterations; each is a pass over A.
    change
        Path of the image over the last third of them, as a fraction of its norm; an upper bound on
        the remaining path if the changes fall at least like 1/k², see `matrix_free`.
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
    gradient steps for the problem above, see `matrix_free`: some 45 passes where
    there is much noise, up to 190 where there is little. λ follows a photograph's noise and units,
    and fits any grid: where patches are halved, ‖A⊥‖_F halves, and ‖f‖_TV of one image doubles.

    Parameters
    ----------
    A
        (M, N) light transport matrix: an array, a memory map, or `RowBlocks`. For photographs with
        a mask, the rows used are copied into memory.
    regularization
        λ over σ ‖A⊥‖_F, a number without unit, as in `NoiseAware`.
    tolerance
        Stop where the image's way in the last third of the iterations is at most this part of its
        norm. It was then within a tenth of that of the minimum, see `matrix_free`.
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
        problem = Weighed(transport, self.eigenvectors, self.hidden)
        h = transport.rmatmat(y)
        data, energy = problem.data(h), problem.energy(y, h)
        pixels, rank = transport.Q.shape
        freedom = pixels - rank - len(problem.eigenvectors.energy)

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
    def eigenvectors(self) -> Eigenvectors:
        """The strongest eigenvectors of A⊥ᵀA⊥."""
        count = max(min(EIGENVECTORS, self.hidden.patches // 8), 1)
        return self.fit.operator.strongest_eigenvectors(count)

    def _weight(self, noise: Array) -> Array:
        return np.asarray(self.regularization * noise * np.sqrt(self.fit.operator.squared_norm))
