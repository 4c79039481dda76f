"""Parts of the light, each estimated in independent replicas."""

from __future__ import annotations

import dataclasses
from collections.abc import Callable, Iterator
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from periscopy_sim.rendering.ambient.smoothing import Field, best_estimate
from periscopy_sim.scenario import Array

REPLICAS = 8
"""Independent estimates, from whose scatter the error is told."""

SITES = 256
"""Pixels at which bounced light is estimated."""

RAYS = 256
"""Rays from each of them in a round."""

RAY = 100
"""Time of such a ray, with the paths that go on from what it meets and its shadow rays, in samples
of direct light: measured in a room with windows."""


@dataclass(eq=False)
class Part:
    """One part of the light, estimated in replicas at some of the pixels."""

    estimate: Callable[[int], Array]  # maps a seed to the (S, 3) irradiance at the sites
    sites: NDArray[np.intp]  # (S,) row-major indices of pixels
    shape: tuple[int, int]  # of the photograph
    work: float = 1.0  # time of a round, in any unit
    rounds: int = 0  # how often samples were added
    field: Field = dataclasses.field(init=False)  # at every pixel, after the first round
    _sum: Array = dataclasses.field(default_factory=lambda: np.zeros(()))

    def add_round(self, seeds: Iterator[int]) -> None:
        """Add samples to every replica, and estimate the field anew."""
        from threadpoolctl import threadpool_limits

        with threadpool_limits(1):  # the last bits follow the number of threads
            self._sum = self._sum + [self.estimate(next(seeds)) for _ in range(REPLICAS)]
            self.rounds += 1
            self.field = best_estimate(self._sum / self.rounds, self.sites, self.shape)
