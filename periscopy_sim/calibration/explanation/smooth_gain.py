"""A smooth gain over the wall that no scene tells: a lens, light that bounces, a monitor's falloff.

    y_c = g (A f_c) + B b_c + n_c,   g = 1 + Σ_k a_k p_k,   a_k ~ N(0, SPREAD²),

p_k the polynomials of degree ≤ 2 over the wall, without the constant: those of `wall_gain`, which
finds the gain when a photograph is reconstructed. A scene that is explained without it moves until
its shadows are as bright as the gain makes them. Near a gain of a⁰ that is known already, the light
is linear in a. What explains a photograph is followed by

    â = argmin_a min_f Σ_c (‖(y_c − g⁰ (A f_c) − Σ_k (a_k − a⁰_k) p_k A f̂_c)⊥‖² + α_c f_cᵀK f_c)
        / (σ_c² κ) + V(a) / κ + ‖a‖² / SPREAD²,

f̂ the image with g⁰ alone, V the volume of the images' evidence (Σ log(1 + μ/α) of g A), linear near
a⁰. Without V a gain that dims what the photograph knows well would pass for a simpler scene: at a
true scene without a gain it was found four standard errors off. The gain itself is fitted, not
integrated over as the image is. What it could follow tells of no parameter.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Self

import numpy as np
from numpy.typing import NDArray

from periscopy_sim.model.wall_gain import (
    BOUNDS,
    DEGREE,
    SPREAD,
    polynomials,
)

Array = NDArray[np.float64]


@dataclass(frozen=True, eq=False)
class SmoothGain:
    """A gain over the used pixels of a photograph."""

    terms: Array  # (K, M) p_k
    coefficients: Array  # (K,) a

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
        return float(np.sum(self.coefficients**2)) / SPREAD**2

    def moved(self, change: Array) -> Self:
        """Return it with other coefficients, not so far that it were no gain any more."""
        for part in (1.0, 0.5, 0.25):
            other = replace(self, coefficients=self.coefficients + part * change)
            if BOUNDS[0] < other.field.min() and other.field.max() < BOUNDS[1]:
                return other
        return self
