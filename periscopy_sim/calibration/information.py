"""What a photograph tells about the parameters near a point: Fisher information, standard errors.

The information is how the photograph moves with a parameter, beyond what hidden image and light can
follow (Gauss and Newton's approximation; Kaufman, BIT 15, 1975).
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]

UNSEEN = 1e-4
"""Fraction of the information that is added where no ruler knows a parameter."""

BLOCKS = (10, 5)
"""Along each side of the photograph: residuals are independent between blocks of either size."""


@dataclass(frozen=True, eq=False)
class Curvature:
    """What the photograph tells about P parameters near a point.

    Attributes
    ----------
    slope
        (P,) derivatives of half the evidence, the prior's penalty included.
    information
        (P, P) Fisher information of the photograph alone.
    beyond
        (P, M, 3) how the photograph moves, over σ κ^½, that the hidden image cannot follow.
    precision
        (P,) the prior's.
    ruled
        (P,) derivatives of half the prior's penalty.
    """

    slope: Array
    information: Array
    beyond: Array
    precision: Array
    ruled: Array

    def damped(self, damping: float = 0.0) -> Array:
        """Return information and precision, (P, P), with a fraction of the information added.

        Negative eigenvalues, of the noise of rays, are cut off.
        """
        diagonal = np.maximum(np.diag(self.information), 0)
        scale = np.sqrt(np.where(diagonal + self.precision > 0, diagonal + self.precision, 1.0))
        values, vectors = np.linalg.eigh(self.information / np.outer(scale, scale))
        seen = (vectors * np.maximum(values, 0)) @ vectors.T * np.outer(scale, scale)
        unknown = np.where(self.precision > 0, damping, max(damping, UNSEEN))
        extra = unknown * np.where(diagonal > 0, diagonal, scale**2)
        return np.asarray(seen + np.diag(extra + self.precision))

    def step(self, damping: float, longest: Array, free: NDArray[np.bool_]) -> Array:
        """Return Newton's step, (P,), of the free parameters, none longer than allowed, (P,)."""
        step = np.zeros(len(free))
        step[free] = -np.linalg.solve(self.damped(damping)[np.ix_(free, free)], self.slope[free])
        return np.asarray(step * min(1.0, np.min(longest / np.maximum(np.abs(step), 1e-300))))

    @property
    def predicted_gain(self) -> float:
        """Gain in evidence that the slope predicts for a whole step."""
        return float(self.slope @ np.linalg.solve(self.damped(), self.slope))

    def absorb(self, errors: Array) -> Array:
        """Return what the parameters leave of errors, (M, 3), that image and light left."""
        pull = np.einsum("pmc,mc->p", self.beyond, errors)
        by_parameters = np.linalg.solve(self.damped(), pull)
        return np.asarray(errors - np.einsum("p,pmc->mc", by_parameters, self.beyond))

    def of(self, some: NDArray[np.bool_]) -> Curvature:
        """Return what the photograph tells of some parameters, (P,), where the others are known."""
        return Curvature(
            self.slope[some],
            self.information[np.ix_(some, some)],
            self.beyond[some],
            self.precision[some],
            self.ruled[some],
        )

    def tempered(self, overdispersion: float) -> Curvature:
        """Return what the photograph tells where it counts for so much less, the prior as it is."""
        κ = overdispersion
        return replace(
            self,
            slope=(self.slope - self.ruled) / κ + self.ruled,
            information=self.information / κ,
            beyond=self.beyond / np.sqrt(κ),
        )

    def overdispersion(self, partitions: Sequence[Array]) -> float:
        """Return how much more the slope varies than by white noise, from the `block_scores`, or 1.

        It is the mean over what the photograph tells of the parameters, tr(H⁻¹J)/tr(H⁻¹I), by which
        a likelihood is tempered (Ribatet, Cooley and Davison, Statistica Sinica 22, 2012): J is the
        spread of the scores, I the information, H both that and the prior's.
        """
        H = self.damped()
        inverse = np.linalg.inv(H)
        white = np.trace(inverse @ (H - np.diag(self.precision)))
        spreads = [np.trace(inverse @ (scores.T @ scores)) for scores in partitions]
        return max(1.0, float(max(spreads) / white)) if white > 0 else 1.0

    def covariance(self, partitions: Sequence[Array]) -> Array:
        """Return the parameters' covariance, (P, P), from the `block_scores`.

        The residual is no white noise, so its spread is taken from the photograph (the sandwich
        estimate: White, Econometrica 50, 1982), and never below that of white noise.
        """
        inverse = np.linalg.inv(self.damped())
        prior = np.diag(self.precision)
        spreads = [inverse @ (s.T @ s + prior) @ inverse for s in partitions]
        robust = np.max([np.diag(each) for each in spreads], axis=0)
        growth = np.sqrt(np.maximum(robust / np.diag(inverse), 1))
        return np.asarray(inverse * np.outer(growth, growth))

    def block_scores(self, errors: Array, used: NDArray[np.bool_]) -> list[Array]:
        """Return what each block of pixels adds to the pull on the parameters, (blocks, P).

        The errors, (M, 3) over σ κ^½, are of the pixels used, (rows, columns). There is one array
        for each of `BLOCKS`.
        """
        (rows, columns), (height, width) = np.nonzero(used), used.shape
        by_pixel = np.einsum("pmc,mc->mp", self.beyond, errors)
        scores = []
        for count in BLOCKS:
            block = (rows * count // height) * count + columns * count // width
            numbers = np.unique(block)
            scores.append(np.array([by_pixel[block == n].sum(axis=0) for n in numbers]))
        return scores
