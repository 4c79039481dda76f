"""Places where a photograph looks much the same lie on a lattice; which of them the ruler favours.

About each, k whole patches away, evidence and penalty are quadratic in the parameters θ:

    F(k) = min_θ (θ − θ₀ − M k)ᵀ I (θ − θ₀ − M k) + (θ − c)ᵀ Λ (θ − c),

I the Fisher information, θ₀ where the photograph alone has them, Λ and c the ruler's precision and
values. By how much the photograph itself tells the places apart is not known before it is asked; F
says of which to ask. The whole cycles of carrier phases are found in the same way, the likeliest
whole numbers first, all together: one at a time leads astray where moves are oblique [1].

References
----------
[1] Teunissen, "The least-squares ambiguity decorrelation adjustment", J. Geodesy 70, 1995.
"""

from __future__ import annotations

from dataclasses import dataclass
from itertools import product

import numpy as np
from numpy.typing import NDArray

from periscopy_sim.calibration.explanation.resolution_level import Values
from periscopy_sim.calibration.search.fisher_information import Curvature
from periscopy_sim.scenario import Array

REACH = 2
"""Patches, along each move at once, to places that are asked for."""

APART = 0.25
"""Squared distance of two places, over the shortest move's, up to which they are in one dip: some
moves shift the image alike, by the monitor or by the occluder."""

Whole = NDArray[np.intp]


@dataclass(frozen=True, eq=False)
class PatchLattice:
    """Places whole patches away from some values, (P,), along moves, (P, K), none of them 0."""

    about: Curvature
    values: Values
    moves: Array

    def move(self, places: Whole) -> Array:
        """Return how far the parameters move to the least of F at places, (..., K): (..., P)."""
        steps = places @ self.moves.T
        ruled = self.about.prior.precision * steps
        return np.asarray(steps - np.linalg.solve(self.about.invertible(), ruled.T).T)

    def objection(self, places: Whole) -> Array:
        """Return F at places, (..., K), less that at the values themselves, (...)."""
        steps = places @ self.moves.T
        pull = 2 * steps @ self.about.prior.slope(self.values)
        return np.asarray(pull + np.sum(self.about.prior.precision * steps * self.move(places), -1))

    @property
    def apart(self) -> float:
        """Squared distance in F from which on two places are in different dips."""
        return APART * float(self._squared(self.moves.T).min(initial=np.inf))

    def is_beside(self, at: Values) -> bool:
        """Return whether parameters, (P,), are in another dip than the values."""
        return bool(self._squared(at - self.values) > self.apart)

    def favourites(self, count: int, most: float) -> Array:
        """Return where the ruler would rather have the parameters, (n, P), so many places at most.

        Of places as likely the nearest comes first. Those to which it objects by `most` are left
        out, and those in the dip of another, or of the values themselves.
        """
        places = np.array(list(product(range(-REACH, REACH + 1), repeat=self.moves.shape[1])))
        objection = self.objection(places)
        likely = objection < most
        order = np.argsort((objection + np.sum(places**2, axis=1))[likely], kind="stable")
        reached = self.values + self.move(places[likely][order])
        last = self.values
        found: list[Values] = []
        while len(found) < count:
            reached = reached[self._squared(reached - last) > self.apart]
            if not len(reached):
                break
            last = reached[0]
            found.append(last)
        return np.reshape(found, (-1, len(self.values)))

    def _squared(self, moves: Array) -> Array:
        """Return how much F grows along moves, (..., P)."""
        return np.asarray(np.sum(moves @ self.about.invertible() * moves, axis=-1))
