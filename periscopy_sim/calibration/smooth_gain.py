"""A smooth gain over the wall that no scene tells: a lens, light that bounces, a monitor's falloff.

    y_c = g (A f_c) + B b_c + n_c,   g = 1 + Σ_k c_k p_k,   c_k ~ N(0, GAIN²),

p_k the polynomials of degree ≤ 2 over the wall, without the constant: those of `wall_gain`, which
finds the gain when a photograph is reconstructed. A scene that is explained without it moves until
its shadows are as bright as the gain makes them. Near a gain c⁰ that is known already, the light is
linear in c; so what each photograph is explained with is

    ĉ = argmin_c Σ_c ‖(y_c − g⁰ (A f_c) − Σ_k (c_k − c⁰_k) p_k A f̂_c)⊥‖² / (σ_c² κ) + ‖c‖² / GAIN²,

f̂ what explains it with g⁰ alone, f what follows: neither image nor gain counts what the other
could have made, and parameters are told from both.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Any, Self

import numpy as np
from numpy.typing import NDArray

from periscopy_sim.calibration.evidence import Explanation
from periscopy_sim.reconstruction.noise_aware.wall_gain import BOUNDS, DEGREE, polynomials

Array = NDArray[np.float64]

GAIN = 0.15
"""Standard deviation of a polynomial's coefficient: lenses and bounced light made up to 0.2."""


@dataclass(frozen=True, eq=False)
class SmoothGain:
    """A gain over the used pixels of a photograph."""

    terms: Array  # (K, M) p_k
    coefficients: Array  # (K,) c

    @classmethod
    def none(cls, used: NDArray[np.bool_]) -> Self:
        """Return a gain of 1 over the pixels used, (rows, columns)."""
        terms = polynomials((used.shape[0], used.shape[1]), 1, DEGREE)[:, used.ravel()]
        return cls(terms, np.zeros(len(terms)))

    @property
    def field(self) -> Array:
        """(M,) g."""
        return np.asarray(1 + self.coefficients @ self.terms)

    @property
    def penalty(self) -> float:
        """Twice the negative logarithm of its density before the photograph, less a constant."""
        return float(np.sum(self.coefficients**2)) / GAIN**2

    def moved(self, change: Array) -> Self:
        """Return it with other coefficients, not so far that it were no gain any more."""
        for part in (1.0, 0.5, 0.25):
            other = replace(self, coefficients=self.coefficients + part * change)
            if BOUNDS[0] < other.field.min() and other.field.max() < BOUNDS[1]:
                return other
        return self

    def explained(self, found: Explanation, A: NDArray[np.floating[Any]]) -> Explanation:
        """Return what explains a photograph with the best gain near this one, see the module.

        `found` is what explains it by `field` times A, (M, N).
        """
        light = A @ found.images
        terms = found.without_background(self.terms[:, :, None] * light) / found.deviations
        beyond = np.array([found.beyond_image(term) for term in terms])
        residuals = found.residuals / found.deviations
        by_channel = np.einsum("jmc,kmc->cjk", beyond, terms, optimize=True)
        pull = np.einsum("kmc,mc->ck", terms, residuals)
        H = by_channel.sum(axis=0) + np.eye(len(terms)) / GAIN**2
        q = pull.sum(axis=0) - self.coefficients / GAIN**2
        best = self.moved(np.linalg.solve(H, q))
        change = best.coefficients - self.coefficients
        # Both over σ_c² κ: what a channel's least squares are less by.
        gained = 2 * pull @ change - np.einsum("cjk,j,k->c", by_channel, change, change)
        left = np.maximum(1 - gained * found.overdispersion / found.freedom, 1e-6)
        noise = np.sqrt(left)
        return replace(
            found,
            evidence=found.evidence
            + float(found.freedom * np.log(left).sum()) / found.overdispersion
            + best.penalty,
            noise=found.noise * noise,
            residuals=found.residuals
            - np.einsum("k,kmc->mc", change, beyond, optimize=True) * found.deviations,
            gain=best,
            followed=beyond / noise,
            inverse=np.linalg.inv(H),
        )
