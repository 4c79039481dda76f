"""By how much a scene is elsewhere than its parameters say, told by one photograph.

    y_c = g (A + Σ_k u_k D_k) f_c + B b_c + n_c,   u ~ N(0, I),   g = 1 + Σ_j a_j p_j

Near an image f₀ and a place u₀, at which A is taken, the photograph is linear in f, in v = (u, a),
and in b: with T_k = D_k f₀ and, of the smooth gain over the wall (`wall_gain`), p_j A f₀,

    y ≈ A f + B b + Σ_k (v_k − v₀_k) T_k + n.

Images and ambient light are eliminated, (I − F Fᵀ) is what they leave, F a basis of [A, B]
(variable projection: Kaufman, BIT 15, 1975). Nothing is held against an image: what a smoother one
would tell of the scene is not believed. What is left, r = (I − F Fᵀ) y, is no white noise where the
model is wrong; if it is κ times as strong at the scale at which it is strongest (`overdispersion`),
the photograph counts for 1/κ against the ruler. With Λ the precision of v before it is looked at, I
of u, and H = Tᵀ(I − F Fᵀ)T / σ²κ,

    v̂ = K (Tᵀ r / σ²κ + H v₀),   K = (Λ + H)⁻¹.

D is rendered, and images follow nearly all of what it does. In the little that they leave, noise
multiplied by itself would pass for information; so there are two sets of rays, T = (T₁ + T₂)/2, and
H̄ = T₁ᵀ(I − F Fᵀ)T₂ / σ²κ is free of it. Noise in T draws v̂ towards the ruler's, and no farther; v₀
is given back by H̄. By areas D has no noise, and one set serves as both. The errors are those of
this estimator, not of one that knew D:

    Cov(v̂ − v) = (I − K H̄) Λ⁻¹ (I − K H̄)ᵀ + K H K,

which is K without noise in D, and Λ⁻¹ where noise is all there is.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from periscopy_sim.reconstruction.noise_aware.nuisance.wall_gain import SPREAD

Array = NDArray[np.float64]
Unexplained = Callable[[Array], Array]
"""Returns (I − F Fᵀ) of rows, (J, M')."""


@dataclass(frozen=True, eq=False)
class Displacement:
    """Where a scene is, in standard errors of its directions, and how sure that is."""

    moved: Array  # (K,) û
    covariance: Array  # (K, K) of û − u
    overdispersion: float  # κ, by which the photograph counts for less

    @classmethod
    def none(cls, directions: int) -> Displacement:
        """Return that of a scene that is where it is said to be, as far as is known."""
        return cls(np.zeros(directions), np.eye(directions), 1.0)

    def reached(self, u: Array) -> Displacement:
        """Return it with the scene at u, (K,), instead, and what is missing counted as error."""
        missing = self.moved - u
        return Displacement(u, self.covariance + np.outer(missing, missing), self.overdispersion)


def estimate(
    left: Array,
    lights: Array,
    gains: Array,
    unexplained: Unexplained,
    overdispersion: float,
    here: Array,
    *,
    exact: bool,
) -> Displacement:
    """Return û and its covariance; see the module.

    Parameters
    ----------
    left
        (3, M') r over σ.
    lights
        (1 or 2, K, 3, M') T of the directions, range(B) in it or not, over σ.
    gains
        (J, 3, M') T of the gain, likewise.
    unexplained
        (I − F Fᵀ).
    overdispersion
        κ.
    here
        (K,) u₀.
    exact
        Whether A was rendered at u₀, rather than made of D and its noise.
    """
    count, pixels = len(here), left.shape[1]
    sets = [np.concatenate([each, gains]) for each in lights]
    first, *rest = (
        unexplained(each.reshape(-1, pixels)).reshape(len(each), -1).astype(np.float64)
        for each in sets
    )
    second = rest[0] if rest else first
    T = (first + second) / 2
    H = T @ T.T / overdispersion
    crossed = first @ second.T / overdispersion
    clean = (crossed + crossed.T) / 2
    variances = np.ones(len(T))
    variances[count:] = SPREAD**2
    K = np.linalg.inv(np.diag(1 / variances) + H)
    v = np.zeros(len(T))
    v[:count] = here
    back = clean if exact else H
    found = K @ (T @ left.ravel() / overdispersion + back @ v)
    kept = np.eye(len(T)) - K @ clean
    covariance = (kept * variances) @ kept.T + K @ H @ K
    return Displacement(found[:count], covariance[:count, :count], overdispersion)
