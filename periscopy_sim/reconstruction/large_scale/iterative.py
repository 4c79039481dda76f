"""Recovery without P: for hidden images so fine that P, or even A, does not fit in memory.

    f̂ = argmin_f ‖W (A⊥ f − y⊥)‖₂² + λ‖f‖_TV,   A⊥ = A − Q QᵀA,   Q an orthonormal basis of range(B)

where W weighs the few eigenvectors that the wall shows best down, see `matrix_free`.

Without the total variation this is P y (Eq. 8), since P is the pseudoinverse of A⊥. The paper
applies total variation to P y instead (Eq. 10), which takes its noise for white. Where P y is
nearly all noise, as on fine grids, the problem above is the one that is well posed.
"""

from __future__ import annotations

import warnings
from dataclasses import dataclass
from functools import cached_property
from typing import Any

import numpy as np
from numpy.typing import NDArray

from periscopy_sim.numerics.validation import check_stopping
from periscopy_sim.reconstruction.background_subspace import RANK_TOLERANCE, background_basis
from periscopy_sim.reconstruction.large_scale.matrix_free import (
    least_squares,
    total_variation_least_squares,
)
from periscopy_sim.reconstruction.large_scale.transport_operator import (
    Eigenvectors,
    Matrix,
    TransportOperator,
    used_rows,
)
from periscopy_sim.reconstruction.method import StillMethod
from periscopy_sim.reconstruction.observation import Mask, observation_of

Array = NDArray[np.float64]
Image = NDArray[np.floating[Any]]

EIGENVECTORS = 40
"""Eigenvectors of A⊥ᵀA⊥ found once for a scene, see `matrix_free`; of few patches an eighth."""

SETTLED = 0.01
"""Conjugate gradients stop where `SETTLING` of them lower the noise estimate by less than this."""


@dataclass(frozen=True, eq=False)
class IterativeReconstruction:
    """A hidden image and how the iterations ended.

    Attributes
    ----------
    least_squares
        (R, C, 3) where conjugate gradients ended.
    image
        (R, C, 3) the result, in units of the photograph's over those of A.
    noise
        (3,) standard deviation of the photograph's noise, as estimated by conjugate gradients.
    weight
        (3,) the total-variation weight λ used for each channel.
    residual
        (3,) ‖y⊥ − A⊥f‖ / √(M − r) of the result, in units of the photograph; with total variation
        about the noise.
    iterations
        Those of conjugate gradients and of the proximal gradient method, a pass over A each.
    change
        What the last iteration left, see `IterativePeriscope`.
    converged
        Whether that is what was asked for.
    """

    least_squares: Array
    image: Array
    noise: Array
    weight: Array
    residual: Array
    iterations: tuple[int, int]
    change: float
    converged: bool


class IterativePeriscope(StillMethod[np.float64]):
    """The paper's problem solved by iterations, without P and without an N x N matrix.

    Fitting to a scene takes one pass over A, and some 120 with the first photograph for the
    `EIGENVECTORS` that the wall shows best. Each photograph then takes two stages:

    - Conjugate gradients for the least squares, which stop as soon as their estimate of the noise
      σ has settled (`SETTLED`): some 40 passes.
    - From there, accelerated proximal gradient steps for ‖W(A⊥f − y⊥)‖² + λ‖f‖_TV, see
      `matrix_free`, with λ = `regularization` σ ‖A⊥‖_F. That follows the photograph's noise and
      units, and fits any grid: where patches are halved, ‖A⊥‖_F halves, and ‖f‖_TV of one image
      doubles. They stop when a step, momentum aside, changes f by less than `tolerance` of its
      norm: some 100 passes.

    With `regularization` 0 the conjugate gradients alone go on until the gradient is below
    `tolerance` times the first, and give P y.

    Parameters
    ----------
    A
        (M, N) light transport matrix: an array, a memory map, or `RowBlocks`.
    B
        (M, L) prototype backgrounds; None for none.
    hidden_shape
        (R, C) with R C = N.
    channel_gain
        (3,) positive colour of the wall, `Scenario.channel_gain`; None for a grey wall.
    rank_tolerance
        Relative tolerance on B's singular values, see `background_basis`.
    regularization
        λ over σ ‖A⊥‖_F, a number without unit, as in `NoiseAware`.
    tolerance, max_iterations
        Where the last stage stops.
    photograph_shape
        (rows, columns) that photographs must have; None checks the number of pixels alone.
    mask
        (rows, columns) or (M,), True where the wall is to be used; None for everywhere. The other
        rows of A and B are left out, and what the photograph holds there, be it NaN.
        Of an array that is a copy; memory maps and `RowBlocks` are read whole, block by block.

    Raises
    ------
    ValueError
        If the shapes do not fit, the mask leaves fewer pixels than patches, A or B is not finite,
        the wall reflects nothing in a channel, or a number is out of range.
    """

    def __init__(
        self,
        A: Matrix,
        B: Image | None = None,
        *,
        hidden_shape: tuple[int, int],
        channel_gain: Image | None = None,
        rank_tolerance: float = RANK_TOLERANCE,
        regularization: float = 0.015,
        tolerance: float = 1e-4,
        max_iterations: int = 1000,
        photograph_shape: tuple[int, int] | None = None,
        mask: Mask | None = None,
    ) -> None:
        if not 0 <= regularization < np.inf:
            raise ValueError(
                f"regularization is {regularization}: give a finite number, not negative"
            )
        check_stopping(tolerance, max_iterations)
        # Only the shape is looked at, so that A need not be an array.
        shaped = np.broadcast_to(np.float32(0), A.shape)
        self._observation = observation_of(
            shaped, hidden_shape, channel_gain, mask, photograph_shape
        )
        if self._observation.mask is not None:
            A = used_rows(A, self._observation.mask.ravel())
            B = None if B is None else self._observation.used(B)
        self.photograph_shape = photograph_shape
        self.hidden_shape = hidden_shape
        self.regularization = regularization
        self.tolerance = tolerance
        self.max_iterations = max_iterations
        Q = None if B is None else background_basis(B, rank_tolerance)
        self.transport = TransportOperator(A, Q)

    def solve(self, photograph: Image) -> IterativeReconstruction:
        """Recover the hidden image and tell how the iterations ended; see `reconstruct`."""
        planes = self._observation.planar(np.asarray(photograph)[None], self.photograph_shape)
        y = self.transport.reject_background(planes[0].T)
        result = self._least_squares(y) if self.regularization == 0 else self._total_variation(y)
        if not result.converged:
            warnings.warn(
                f"stopped after {self.max_iterations} iterations, the last of which changed "
                f"{result.change:.1e}, above {self.tolerance:.1e}: raise max_iterations or "
                "tolerance",
                RuntimeWarning,
                stacklevel=2,
            )
        return result

    @cached_property
    def eigenvectors(self) -> Eigenvectors:
        """The strongest eigenvectors of A⊥ᵀA⊥."""
        return self.transport.strongest_eigenvectors(
            max(min(EIGENVECTORS, self.transport.shape[1] // 8), 1)
        )

    def _least_squares(self, y: Array) -> IterativeReconstruction:
        solved = least_squares(
            self.transport, y, tolerance=self.tolerance, max_iterations=self.max_iterations
        )
        image, change = self._observation.image(solved.f), float(solved.gradient.max())
        return IterativeReconstruction(
            least_squares=image,
            image=image,
            noise=solved.noise,
            weight=np.zeros(3),
            residual=self._residual(solved.misfit),
            iterations=(solved.iterations, 0),
            change=change,
            converged=change <= self.tolerance,
        )

    def _total_variation(self, y: Array) -> IterativeReconstruction:
        start = least_squares(
            self.transport,
            y,
            settled=SETTLED,
            max_iterations=self.max_iterations,
            eigenvectors=self.eigenvectors,
        )
        weight = self.regularization * start.noise * np.sqrt(self.transport.squared_norm)
        solved = total_variation_least_squares(
            self.transport,
            self.eigenvectors,
            start.h,
            weight,
            start.f,
            image_shape=self.hidden_shape,
            tolerance=self.tolerance,
            max_iterations=self.max_iterations,
        )
        return IterativeReconstruction(
            least_squares=self._observation.image(start.f),
            image=self._observation.image(solved.f),
            noise=start.noise,
            weight=weight,
            residual=self._residual(np.sum(y**2, axis=0) + solved.descent),
            iterations=(start.iterations, solved.iterations),
            change=solved.change,
            converged=solved.change <= self.tolerance,
        )

    def _residual(self, misfit: Array) -> Array:
        freedom = max(self.transport.Q.shape[0] - self.transport.Q.shape[1], 1)
        residual: Array = np.sqrt(np.maximum(misfit, 0) / freedom)
        return residual
