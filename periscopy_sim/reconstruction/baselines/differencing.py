"""The method of [15] (Eq. 2 and 3): least squares of neighbouring pixels' differences.

References
----------
[15] Saunders, Murray-Bruce, Goyal, "Computational periscopy with an ordinary digital camera",
Nature, 2019.
"""

from __future__ import annotations

import warnings
from collections.abc import Callable
from dataclasses import dataclass
from functools import partial
from typing import Any, Literal

import numpy as np
from numpy.typing import NDArray

from periscopy_sim.numerics.validation import check_stopping
from periscopy_sim.reconstruction.baselines.neighbour_differences import neighbour_differences
from periscopy_sim.reconstruction.baselines.published_steps import descend_as_published
from periscopy_sim.reconstruction.method import StillMethod
from periscopy_sim.reconstruction.observation import Mask, observation_of
from periscopy_sim.reconstruction.preconditioned.preconditioner import form_preconditioner
from periscopy_sim.reconstruction.preconditioned.still import noise_level
from periscopy_sim.reconstruction.total_variation.least_squares import (
    LeastSquares,
    LeastSquaresMinimum,
)

Array = NDArray[np.float64]
Image = NDArray[np.floating[Any]]

PUBLISHED_ENTRY = 5e3
"""Mean entry of A in the units of the published code of [15], for the chair experiment."""

PUBLISHED_MEAN = 0.25
"""Mean that a hidden image in [0, 1] is taken to have, where it decides when [15] stops."""

MAX_ITERATIONS = 10_000
"""After so many iterations, far more than any photograph should need, differencing gives up."""


@dataclass(frozen=True, eq=False)
class DifferencingResult:
    """A hidden image by differencing and how its iterations ended.

    Attributes
    ----------
    image
        (R, C, 3) the result, in units of the photograph's over those of A.
    noise
        (3,) standard deviation of the differenced photograph's noise, as estimated from it.
    weight
        (3,) the total-variation weight λ used for each channel.
    iterations
        (3,) iterations taken.
    gap
        (3,) the relative duality gap that was left, see `least_squares.LeastSquaresMinimum`.
    """

    image: Array
    noise: Array
    weight: Array
    iterations: NDArray[np.int64]
    gap: Array


class Differencing(StillMethod[np.float64]):
    """The method of [15]: f̂ = argmin_f ‖D(A f − y)‖² + λ‖f‖_TV for each channel (Eq. 2).

    λ follows the photograph: it is `tv_weight` σ ‖D A‖_F / √N, with σ the noise of the differenced
    photograph, estimated from what D A cannot explain of it. So λ is `tv_weight` standard
    deviations of what noise adds to an entry of (D A)ᵀD y, and neither exposure nor albedo nor
    units need tuning. The weights that [15] chose by hand for each image are of that size.

    Each channel is a problem of its own, with steps and an end of its own. An iteration costs one
    product with the N x N Gram matrix, or three to four with the published steps.

    Parameters
    ----------
    A
        (M, N) light transport matrix.
    B
        Not used: the method knows no backgrounds.
    photograph_shape, hidden_shape
        (rows, columns) with products M and N.
    channel_gain
        (3,) positive colour of the wall, `Scenario.channel_gain`; None for a grey wall.
    mask
        (rows, columns) or (M,), True where the wall is to be used; None for everywhere. A
        difference counts only if both its pixels are used, see `neighbour_differences`.
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
        If the shapes do not fit, the mask leaves fewer pixels or differences than patches, D A has
        not full column rank, the wall reflects nothing in a channel, or a number is out of range.
    """

    def __init__(
        self,
        A: Image,
        B: Image | None = None,  # noqa: ARG002
        *,
        photograph_shape: tuple[int, int],
        hidden_shape: tuple[int, int],
        channel_gain: Image | None = None,
        mask: Mask | None = None,
        wrap: bool = True,
        tv_weight: float = 1.0,
        stop: Literal["converged", "published"] = "converged",
        tolerance: float = 1e-7,
    ) -> None:
        if stop not in ("converged", "published"):
            raise ValueError(f"stop is '{stop}': give 'converged' or 'published'")
        if not 0 <= tv_weight < np.inf:
            raise ValueError(f"tv_weight is {tv_weight}: give a finite number, not negative")
        check_stopping(tolerance)
        self._observation = observation_of(A, hidden_shape, channel_gain, mask, photograph_shape)
        A = self._observation.used(A)
        self.photograph_shape = photograph_shape
        self.hidden_shape = hidden_shape
        self.wrap = wrap
        self.tv_weight = tv_weight
        self.stop = stop
        self.tolerance = tolerance
        # Without backgrounds this is the pseudoinverse of D A: least squares and what they leave.
        DA = self._differenced(np.asarray(A, np.float64))
        if mask is not None and len(DA) < A.shape[1]:
            raise ValueError(
                f"the mask leaves {len(DA)} differences of neighbouring pixels for {A.shape[1]} "
                "patches: leave out less of the wall, or use fewer patches"
            )
        self._inverse = form_preconditioner(DA)
        R = self._inverse.cholesky
        self._least_squares = LeastSquares(R.T @ R, R, hidden_shape)
        self._unit = PUBLISHED_ENTRY / float(np.mean(A, dtype=np.float64))

    def solve(self, photograph: Image) -> DifferencingResult:
        """Recover the hidden image and tell how the iterations ended; see `reconstruct`."""
        y = self._observation.vectorized(photograph, self.photograph_shape)
        Dy = self._differenced(y)
        h = self._inverse.A.T @ Dy
        least_squares = self._inverse.solve(h)
        noise = noise_level(
            self._inverse, *(np.ascontiguousarray(part.T) for part in (Dy, least_squares))
        )
        weight = self.tv_weight * noise * np.sqrt(np.trace(self._least_squares.gram) / len(h))
        minimize = self._minimizer(h)
        minima = [
            minimize(self._least_squares, h_c, λ)
            for h_c, λ in zip(np.ascontiguousarray(h.T), weight.tolist(), strict=True)
        ]
        gap = np.array([minimum.gap for minimum in minima])
        if self.stop == "converged" and not (gap <= self.tolerance).all():
            warnings.warn(
                f"differencing stopped after {MAX_ITERATIONS} iterations at a relative duality gap "
                f"of {gap.max():.1e}, above {self.tolerance:.1e}: raise the tolerance",
                RuntimeWarning,
                stacklevel=2,
            )
        return DifferencingResult(
            image=self._observation.image(np.stack([minimum.f for minimum in minima], axis=1)),
            noise=noise,
            weight=weight,
            iterations=np.array([minimum.iterations for minimum in minima]),
            gap=gap,
        )

    def told(self, found: DifferencingResult) -> dict[str, Any]:
        """Return the noise, the weights, the iterations and the gaps; see `StillMethod`."""
        return {
            "noise": found.noise,
            "lambda": found.weight,
            "iterations": found.iterations,
            "gap": found.gap,
        }

    def _minimizer(self, h: Array) -> Callable[[LeastSquares, Array, float], LeastSquaresMinimum]:
        if self.stop == "converged":
            return partial(
                LeastSquares.minimize, tolerance=self.tolerance, max_iterations=MAX_ITERATIONS
            )
        white = float(np.abs(self._least_squares.best_mean(h)).mean()) / PUBLISHED_MEAN
        return partial(descend_as_published, unit=self._unit, white=white)

    def _differenced(self, A: Array) -> Array:
        differences = neighbour_differences(
            A, self.photograph_shape, wrap=self.wrap, mask=self._observation.mask
        )
        return np.asarray(differences, np.float64)
