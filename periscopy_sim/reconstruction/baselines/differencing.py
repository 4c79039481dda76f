"""The method of [15] (Eq. 2 and 3): least squares of neighbouring pixels' differences.

References
----------
[15] Saunders, Murray-Bruce, Goyal, "Computational periscopy with an ordinary digital camera",
Nature, 2019.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from functools import partial
from typing import Any, Literal, Unpack, get_args

import numpy as np
from numpy.typing import NDArray

from periscopy_sim.model.ambient import background_basis
from periscopy_sim.model.transport_operator import TransportOperator
from periscopy_sim.numerics.validation import check_stopping, check_weight, warn_unconverged
from periscopy_sim.reconstruction.baselines.neighbour_differences import neighbour_differences
from periscopy_sim.reconstruction.baselines.published_steps import descend_as_published
from periscopy_sim.reconstruction.method import Image, Observed, Solution, StillMethod
from periscopy_sim.reconstruction.preconditioned.preconditioner import form_preconditioner
from periscopy_sim.reconstruction.total_variation.least_squares import (
    LeastSquares,
    LeastSquaresMinimum,
)

Array = NDArray[np.float64]
Stop = Literal["converged", "published"]

PUBLISHED_ENTRY = 5e3
"""Mean entry of A in the units of the published code of [15], for the chair experiment."""

PUBLISHED_MEAN = 0.25
"""Mean that a hidden image in [0, 1] is taken to have, where it decides when [15] stops."""

MAX_ITERATIONS = 10_000
"""After so many iterations, far more than any photograph should need, differencing gives up."""


@dataclass(frozen=True, eq=False, repr=False)
class DifferencingResult(Solution[np.float64]):
    """A hidden image by differencing; the noise is that of the differenced photograph."""

    iterations: NDArray[np.int64]  # (3,)
    gap: Array  # (3,) relative duality gap that was left, see `LeastSquaresMinimum`

    def numbers(self) -> dict[str, Any]:
        """Return the noise, the weights, the iterations and the gaps."""
        return {**super().numbers(), "iterations": self.iterations, "gap": self.gap}


class Differencing(StillMethod[np.float64]):
    """The method of [15]: f̂ = argmin_f ‖D(A f − y)‖² + λ‖f‖_TV for each channel (Eq. 2).

    λ follows the photograph: it is `tv_weight` σ ‖D A‖_F / √N, with σ the noise of the differenced
    photograph, estimated from what D A cannot explain of it. So λ is `tv_weight` standard
    deviations of what noise adds to an entry of (D A)ᵀD y, and neither exposure nor albedo nor
    units need tuning. The weights that [15] chose by hand for each image are of that size.

    Each channel is a problem of its own, with steps and an end of its own. An iteration costs one
    product with the N x N Gram matrix, or three to four with the published steps.

    Other parameters and errors are those of `StillMethod`. B serves the residual alone.

    Parameters
    ----------
    photograph_shape
        (rows, columns) of photographs; the method must know it.
    mask
        A difference counts only if both its pixels are used, see `neighbour_differences`.
    wrap
        D as in the published code; or only differences within the photograph's columns, which
        rejects far more of the background, see `neighbour_differences`.
    tv_weight
        λ in standard deviations of what noise adds to an entry of (D A)ᵀD y, as above.
    stop
        ``"converged"``: the minimizer, to a relative duality gap of `tolerance`. ``"published"``:
        where the published code stops, with its steps; see `published_steps`. Its
        constants belong to its units, in which A's mean entry is about 5000 and the hidden image
        lies in [0, 1]; there the uniform image that fits D y best is taken to be 1/4.
    tolerance
        Relative duality gap; only for ``"converged"``.

    Raises
    ------
    ValueError
        If the mask leaves fewer differences than patches, or D A has not full column rank.
    """

    def __init__(
        self,
        A: Image,
        B: Image | None = None,
        *,
        wrap: bool = True,
        tv_weight: float = 1.0,
        stop: Stop = "converged",
        tolerance: float = 1e-7,
        **observed: Unpack[Observed],
    ) -> None:
        super().__init__(A, **observed)
        photograph_shape, mask = self.observation.rows_and_columns, self.observation.mask
        if photograph_shape is None:
            raise ValueError("differencing needs photograph_shape, (rows, columns)")
        if stop not in get_args(Stop):
            raise ValueError(f"stop is '{stop}': give 'converged' or 'published'")
        check_weight("tv_weight", tv_weight)
        check_stopping(tolerance)
        self._ambient = self.observation.ambient(B)
        self._A = A = self.observation.used(A)
        self.wrap = wrap
        self.tv_weight = tv_weight
        self.stop = stop
        self.tolerance = tolerance
        self._differenced = partial(
            neighbour_differences,
            photograph_shape=photograph_shape,
            wrap=wrap,
            mask=mask,
        )
        # The pseudoinverse of D A, background photographs projected out: least squares, and what
        # they leave.
        DA = self._differenced(np.asarray(A, np.float64))
        if mask is not None and len(DA) < A.shape[1]:
            raise ValueError(
                f"the mask leaves {len(DA)} differences of neighbouring pixels for {A.shape[1]} "
                "patches: leave out less of the wall, or use fewer patches"
            )
        light = self.observation.ambient(None) if self.observation.backgrounds else None
        self._inverse = form_preconditioner(DA, None if light is None else self._differenced(light))
        R = self._inverse.cholesky
        self._least_squares = LeastSquares(R.T @ R, R, self.hidden_shape)
        self._unit = PUBLISHED_ENTRY / float(np.mean(A, dtype=np.float64))

    def solve(self, photograph: Image) -> DifferencingResult:
        """Recover the hidden image and tell how the iterations ended; see `reconstruct`."""
        y = self.observation.vectorized(photograph)
        Dy = self._inverse.project_out(self._differenced(y))
        h = self._inverse.A.T @ Dy
        least_squares = self._inverse.solve(h)
        noise = self._inverse.noise(*(np.ascontiguousarray(y.T) for y in (Dy, least_squares)))
        weight = self.tv_weight * noise * np.sqrt(np.trace(self._least_squares.gram) / len(h))
        minimize = self._minimizer(h)
        minima = [
            minimize(self._least_squares, h_c, λ)
            for h_c, λ in zip(np.ascontiguousarray(h.T), weight.tolist(), strict=True)
        ]
        gap = np.array([minimum.gap for minimum in minima])
        if self.stop == "converged":
            warn_unconverged("differencing", MAX_ITERATIONS, float(gap.max()), self.tolerance)
        return DifferencingResult(
            image=self.observation.image(np.stack([minimum.f for minimum in minima], axis=1)),
            noise=noise,
            weight=weight,
            iterations=np.array([minimum.iterations for minimum in minima]),
            gap=gap,
        )

    def projected_transport(self) -> TransportOperator:
        """Return A⊥ of the pixels used; see `StillMethod`."""
        return TransportOperator(self._A, background_basis(self._ambient))

    def _minimizer(self, h: Array) -> Callable[[LeastSquares, Array, float], LeastSquaresMinimum]:
        if self.stop == "converged":
            return partial(
                LeastSquares.minimize, tolerance=self.tolerance, max_iterations=MAX_ITERATIONS
            )
        white = float(np.abs(self._least_squares.best_mean(h)).mean()) / PUBLISHED_MEAN
        return partial(descend_as_published, unit=self._unit, white=white)
