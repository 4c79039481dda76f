"""Places where a photograph looks much the same lie on a lattice; which of them the ruler favours.

About each, k whole patches away, evidence and penalty are quadratic in the parameters θ:

    F(k) = min_θ (θ − θ₀ − M k)ᵀ I (θ − θ₀ − M k) + (θ − c)ᵀ Λ (θ − c),

I the Fisher information, θ₀ where the photograph alone has them, Λ and c the ruler's precision and
values. By how much the photograph itself tells the places apart is not known before it is asked; F
says of which to ask. Each patch, squared, counts as much as 1 of F: nearer places are more alike.
The whole cycles of carrier phases are found in the same way, the likeliest whole numbers first, all
together: one at a time leads astray where moves are oblique [1].

References
----------
[1] Teunissen, "The least-squares ambiguity decorrelation adjustment", J. Geodesy 70, 1995.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property
from itertools import combinations, product

import numpy as np
from numpy.typing import NDArray

from periscopy_sim.calibration.explanation.resolution_level import Values
from periscopy_sim.calibration.search.fisher_information import Curvature
from periscopy_sim.scenario import Array

REACH, TOGETHER = 2, 4
"""Patches along a move, at most, and moves together."""

APART = 0.25
"""Squared distance of two places, over the shortest move's, up to which they are in one dip: some
moves shift the image alike, by the monitor or by the occluder."""

LEAST_APART = 5.0
"""The same in F: bottoms are not found any better."""

Whole = NDArray[np.intp]


@dataclass(frozen=True, eq=False)
class PatchLattice:
    """Places whole patches away from some values, (P,), along moves, (P, K), none of them 0.

    The values are taken for the least of F about them.
    """

    about: Curvature
    values: Values
    moves: Array

    @cached_property
    def root(self) -> Array:
        """(P, P) of which F grows along moves, (..., P), as the squared length of moves @ root."""
        values, vectors = np.linalg.eigh(self.about.invertible())
        return np.asarray(vectors * np.sqrt(np.maximum(values, 0)))

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

    @cached_property
    def apart(self) -> float:
        """Growth of F from which on two places are in different dips."""
        shortest = np.sum((self.moves.T @ self.root) ** 2, axis=-1).min(initial=np.inf)
        return max(APART * float(shortest), LEAST_APART)

    def are_apart(self, places: Array, at: Values) -> NDArray[np.bool_]:
        """Return whether places, (..., P), are in other dips than parameters, (P,)."""
        return np.asarray(np.sum(((places - at) @ self.root) ** 2, axis=-1) > self.apart)

    def favourites(self, count: int, most: float) -> Array:
        """Return where the ruler would rather have the parameters, (n, P), so many places at most.

        Those to which it objects by `most` are left out, and those in the dip of another, or of the
        values themselves.
        """
        places = _whole(self.moves.shape[1])
        objection = self.objection(places)
        order = np.argsort(objection + np.sum(places**2, axis=1), kind="stable")
        reached = self.values + self.move(places[order[objection[order] < most]])
        last = self.values
        found: list[Values] = []
        while len(found) < count:
            reached = reached[self.are_apart(reached, last)]
            if not len(reached):
                break
            last = reached[0]
            found.append(last)
        return np.reshape(found, (-1, len(self.values)))


def _whole(count: int) -> Whole:
    """Return vectors of so many whole numbers, (n, count), of which few are not 0."""
    numbers = [n for n in range(-REACH, REACH + 1) if n]
    blocks = [np.zeros((1, count), int)]
    for together in range(1, min(count, TOGETHER) + 1):
        values = np.array(list(product(numbers, repeat=together)))
        for axes in combinations(range(count), together):
            block = np.zeros((len(values), count), int)
            block[:, axes] = values
            blocks.append(block)
    return np.concatenate(blocks)
