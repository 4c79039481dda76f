"""Parts of the light, each estimated in independent replicas."""

from __future__ import annotations

from collections.abc import Callable, Iterator

import numpy as np
from numpy.typing import NDArray

from periscopy_sim.rendering.ambient.smoothing import Field, best_estimate
from periscopy_sim.scenario import Array

REPLICAS = 8
"""Independent estimates, from whose scatter the error is told."""

SITES = 16
"""Points along each side of the photograph at which bounced light is estimated: more than the
polynomials' degree needs, so that a misfit shows."""

PATHS = 256
"""Paths from each of them in a round."""


class Part:
    """One part of the light, estimated in replicas at some of the pixels.

    `estimate` maps a seed to the (S, 3) irradiance at the `sites`, (S,) row-major indices of
    pixels. `rounds` counts how often samples were added; `field` is the light at every pixel after
    the first.
    """

    def __init__(
        self, estimate: Callable[[int], Array], sites: NDArray[np.intp], shape: tuple[int, int]
    ) -> None:
        self._estimate = estimate
        self._sites = sites
        self._shape = shape
        self._sum = np.zeros((REPLICAS, len(sites), 3))
        self.rounds = 0
        self.field: Field

    def add_round(self, seeds: Iterator[int]) -> None:
        """Add samples to every replica, and estimate the field anew."""
        self._sum += np.stack([self._estimate(next(seeds)) for _ in range(REPLICAS)])
        self.rounds += 1
        self.field = best_estimate(self._sum / self.rounds, self._sites, self._shape)
