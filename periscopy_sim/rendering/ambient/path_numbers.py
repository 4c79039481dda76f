"""Numbers by which paths are drawn: of low discrepancy, many dimensions of a path together.

They are a scrambled Sobol sequence [1] whose digits each seed shifts anew [2], so that estimates by
several seeds are independent and have no bias. Further dimensions are those of the sequence again,
its points in a random order [3].

References
----------
[1] Matousek, "On the L2-discrepancy for anchored boxes", Journal of Complexity, 1998.

[2] L'Ecuyer, Lemieux, "Recent advances in randomized quasi-Monte Carlo methods", in "Modeling
uncertainty", 2002.

[3] Owen, "Latin supercube sampling for very high-dimensional simulations", ACM Transactions on
Modeling and Computer Simulation, 1998.
"""

from __future__ import annotations

from typing import Any

import numpy as np
from scipy.stats import qmc

DIMENSIONS = 32
"""Of the sequence, which takes four bytes for each and path."""

ROUNDS = 8
"""Of hashing shifts and orders: of four, which are usual, neighbours are alike."""

SCRAMBLE = 0
"""Seed of the sequence's scrambling, which the shifts make random."""


class PathNumbers:
    """Numbers in [0, 1) of so many paths from each of several origins.

    One dimension more of the sequence is spent on the order of the paths, which is by origin. So
    each origin has paths of low discrepancy, and all of them together have.

    Parameters
    ----------
    origins
        How many.
    parts
        Paths from each origin that make a set of low discrepancy by themselves, and further ones:
        paths are ordered by part, then by origin.
    """

    def __init__(self, origins: int, parts: tuple[int, ...]) -> None:
        import mitsuba as mi

        self._paths = count = origins * sum(parts)
        sequence = qmc.Sobol(1 + DIMENSIONS, rng=np.random.default_rng(SCRAMBLE))
        points = sequence.random_base2(int(np.ceil(np.log2(count))))[:count]
        ends = np.cumsum([origins * each for each in parts])[:-1]
        order = np.concatenate(
            [
                part[np.argsort(points[part, 0], kind="stable")]
                for part in np.split(np.arange(count), ends)
            ]
        )
        self._digits = mi.UInt32((points[order, 1:].T * 2.0**32).astype(np.uint32).ravel())

    def shifted(self, seed: int) -> ShiftedNumbers:
        """Return the numbers of a seed of 32 bits."""
        return ShiftedNumbers(self._digits, self._paths, seed)


class ShiftedNumbers:
    """Numbers of paths, by dimension: Dr.Jit arrays of as many as there are paths."""

    def __init__(self, digits: Any, paths: int, seed: int) -> None:
        import drjit as dr
        import mitsuba as mi

        self._digits, self._paths = digits, paths
        self._dimensions = len(digits) // paths
        self._seed = dr.opaque(mi.UInt32, seed)

    def at(self, dimension: Any) -> Any:
        """Return each path's number of a dimension, a Dr.Jit integer."""
        import drjit as dr
        import mitsuba as mi

        shift, order = mi.sample_tea_32(self._seed, dimension // self._dimensions, ROUNDS)
        path = dr.arange(mi.UInt32, self._paths)
        again = dimension >= self._dimensions
        path = dr.select(again, mi.permute_kensler(path, self._paths, order, again), path)
        place = dimension % self._dimensions * self._paths + path
        shift ^= mi.sample_tea_32(self._seed, ~dimension, ROUNDS)[0]
        return mi.Float((dr.gather(mi.UInt32, self._digits, place) ^ shift) >> 8) * 2.0**-24
