"""Parts of a configuration: numbers, fixed or drawn anew each time, and sources drawn by weight."""

import math
from pathlib import Path
from typing import Annotated, Any, Self

import numpy as np
from pydantic import AfterValidator, Field, model_validator

from periscopy_sim.numerics.limits import RANGES
from periscopy_sim.storage.formats.yaml_document import Number, Strict

Pair = tuple[Number, Number]


class Distribution(Strict):
    """A number, or how to draw one: exactly one of these is given."""

    value: Number | None = None  # in the file the bare number
    uniform: Pair | None = None  # [low, high]
    log_uniform: Pair | None = None  # [low, high]: draws all orders of magnitude alike
    normal: Pair | None = None  # [mean, standard deviation]
    choice: Annotated[tuple[Number, ...], Field(min_length=1)] | None = None  # all alike

    @model_validator(mode="before")
    @classmethod
    def _from_number(cls, given: Any) -> Any:
        return given if isinstance(given, cls | dict) else {"value": given}

    @model_validator(mode="after")
    def _is_one(self) -> Self:
        if sum(given is not None for _, given in self) != 1:
            raise ValueError(
                "give a number, or one of uniform: [low, high], log_uniform: [low, high], "
                "normal: [mean, standard deviation], choice: [numbers]"
            )
        low, high = self.uniform or self.log_uniform or (0, 0)
        deviation = self.normal[1] if self.normal else 0
        if low > high or deviation < 0 or (self.log_uniform and low <= 0):
            raise ValueError("an interval runs backwards or, if log_uniform, down to 0; or a "
                             "standard deviation is negative")  # fmt: skip
        return self

    @property
    def bounds(self) -> tuple[float, float]:
        """Return the least and the greatest that can be drawn."""
        if self.normal is not None:
            return (-math.inf, math.inf) if self.normal[1] else (self.normal[0],) * 2
        values = self.choice or self.uniform or self.log_uniform or (self.value or 0.0,)
        return min(values), max(values)

    @property
    def is_continuous(self) -> bool:
        """Return whether no two draws are alike."""
        return self.bounds[0] < self.bounds[1] and self.choice is None

    def draw(self, rng: np.random.Generator) -> float:
        """Draw a number."""
        if self.uniform is not None:
            return float(rng.uniform(*self.uniform))
        if self.log_uniform is not None:
            low, high = np.log(self.log_uniform)
            # Rounding could leave the interval by an ulp.
            return float(np.clip(np.exp(rng.uniform(low, high)), *self.log_uniform))
        if self.normal is not None:
            return float(rng.normal(*self.normal))
        if self.choice is not None:
            return self.choice[int(rng.integers(len(self.choice)))]
        assert self.value is not None
        return self.value


class Source(Strict):
    """An entry of a list that is drawn from by weight, relative to the others."""

    weight: Annotated[Number, Field(gt=0, le=1e6)] = 1.0

    def located(self, folder: Path) -> Self:  # noqa: ARG002
        """Return the source with absolute paths, from a configuration's folder; they must exist."""
        return self

    def identity(self) -> dict[str, Any]:
        """Return entries that replace paths in an archive: names, and digests of contents."""
        return {}


def within(*ends: Any) -> Any:
    """Return a type for distributions that are drawn from [low, high], or from a kind's range."""
    low, high = ends if len(ends) == 2 else RANGES[ends[0]].ends

    def check(distribution: Distribution) -> Distribution:
        least, most = distribution.bounds
        if not (low <= least and most <= high):
            raise ValueError(f"every value must lie from {low:g} to {high:g}")
        return distribution

    return Annotated[Distribution, AfterValidator(check)]
