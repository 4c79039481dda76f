"""What a design varies: parameters of a scene, each over a range, and which points are tried."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from itertools import product
from typing import Any

import numpy as np
from numpy.typing import NDArray

from periscopy_sim.errors import PeriscopyError

Array = NDArray[np.float64]

ROUNDING = 1e-12
"""Of a range: values nearer to 0 are meant to be 0."""

MOST_POINTS = 20_000
"""Of one design: at a second each some hours."""


@dataclass(frozen=True)
class Variation:
    """Ranges of parameters, and how many points of them are tried.

    Attributes
    ----------
    ranges
        The lowest and the highest value of each parameter, by its name.
    grid
        Values of each parameter, the ends included, all of which are combined; None for draws.
    draws
        Points spread over the ranges instead: Halton's sequence, scrambled by the seed. More of
        them begin with the same ones.
    seed
        Of the draws.

    Raises
    ------
    PeriscopyError
        If no parameter varies, a range is empty or not finite, or there are too many points.
    """

    ranges: Mapping[str, tuple[float, float]]
    grid: int | None = None
    draws: int = 64
    seed: int = 0

    def __post_init__(self) -> None:
        if not self.ranges:
            raise PeriscopyError("nothing varies; give NAME=LOW:HIGH of a parameter at least")
        for name, (low, high) in self.ranges.items():
            if not (np.isfinite([low, high]).all() and low < high):
                raise PeriscopyError(
                    f"'{name}' from {low:g} to {high:g}: give a finite number and a higher one"
                )
        if not 1 <= self.count <= MOST_POINTS:
            raise PeriscopyError(
                f"the design has {self.count} points; give 1 to {MOST_POINTS}, by fewer or more "
                "values of each parameter, or by draws"
            )

    @property
    def names(self) -> tuple[str, ...]:
        """The parameters that vary."""
        return tuple(self.ranges)

    @property
    def count(self) -> int:
        """Points that are tried."""
        return self.draws if self.grid is None else self.grid ** len(self.ranges)

    @property
    def is_grid(self) -> bool:
        """Whether the points are all combinations of a few values of each parameter."""
        return self.grid is not None

    def values(self, name: str) -> Array:
        """Return the values of one parameter on the grid, (grid,)."""
        assert self.grid is not None
        if self.grid == 1:
            return np.array([np.mean(self.ranges[name])])
        low, high = self.ranges[name]
        values = np.linspace(low, high, self.grid)
        values[np.abs(values) < ROUNDING * (high - low)] = 0
        return values

    def points(self) -> list[dict[str, str]]:
        """Return the points in order: the value of each parameter as a scene file has it."""
        return [
            {name: as_text(value) for name, value in zip(self.ranges, point, strict=True)}
            for point in self._coordinates()
        ]

    def _coordinates(self) -> Iterator[tuple[float, ...]]:
        if self.grid is not None:
            return product(*(self.values(name) for name in self.ranges))
        from scipy.stats import qmc

        low, high = np.transpose(list(self.ranges.values()))
        spread = qmc.Halton(len(self.ranges), scramble=True, rng=self.seed).random(self.draws)
        return map(tuple, low + (high - low) * spread)

    def settings(self) -> dict[str, Any]:
        """Return all that the points follow from, but for how many draws there are."""
        ranges = {name: list(ends) for name, ends in self.ranges.items()}
        return {"ranges": ranges, "grid": self.grid, "seed": self.seed}


def as_text(value: float) -> str:
    """Return a number as it stands in a scene file; whole ones as such, for counts of pixels."""
    return f"{value + 0.0:.9g}"
