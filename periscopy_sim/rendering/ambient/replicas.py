"""Parts of the light, each estimated in independent replicas, which decide how smooth it is."""

from __future__ import annotations

import dataclasses
from collections.abc import Callable, Iterator
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from periscopy_sim.rendering.wall_polynomials import polynomial_fits
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


@dataclass(frozen=True, eq=False)
class Field:
    """Independent estimates of a field."""

    replicas: Array  # (K, M, 3) at the pixels
    squared_bias: Array  # (3,) of all replicas alike, averaged over pixels
    largest: tuple[int, int] | None  # powers of row and column; None of the samples themselves

    @property
    def squared_error(self) -> float:
        """Expected squared error of the replicas' mean, averaged over pixels and channels."""
        variance = self.replicas.var(axis=0, ddof=1).mean() / len(self.replicas)
        return float(variance + self.squared_bias.mean())


def best_estimate(replicas: Array, sites: NDArray[np.intp], shape: tuple[int, int]) -> Field:
    """Fit polynomials of row and column by least squares, and take those of least error.

    Where every pixel was sampled, the samples themselves compete. `replicas` are (K, S, 3)
    estimates, K of at least 2, at the (S,) row-major indices `sites`.
    """
    best = min(
        polynomial_fits(replicas, sites, shape), key=lambda fit: float(fit.squared_error.mean())
    )
    fitted = best.fields.transpose(1, 0, 2)
    smooth = Field(fitted, best.squared_bias, best.largest)
    if np.array_equal(sites, np.arange(shape[0] * shape[1])):
        return min(
            Field(replicas, np.zeros(3), None), smooth, key=lambda field: field.squared_error
        )
    return smooth


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
