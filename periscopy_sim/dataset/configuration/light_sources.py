"""Ambient light of a data set's photographs: random lamps, rendered conditions, given pictures."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated, Literal

import numpy as np
from pydantic import Field, model_validator

from periscopy_sim.dataset.configuration.distributions import Distribution, Source, within
from periscopy_sim.scenario import Array

Files = Annotated[tuple[str, ...], Field(min_length=1)]
"""As seen from the configuration's folder."""


class Lamps(Source):
    """Point lights at random places, by Eq. 4.

    They lie `across`, `away` from the wall and `up`, in metres from the centre of the camera's
    field of view; `tint` is the standard deviation of the logarithm of each lamp's colour.
    """

    kind: Literal["lamps"]
    number: within(1, 1000) = Distribution(choice=(1, 2, 3, 4, 5, 6))  # type: ignore[valid-type]
    across: within(-1000, 1000) = Distribution(uniform=(-3.0, 3.0))  # type: ignore[valid-type]
    away: within(0.05, 1000) = Distribution(uniform=(1.0, 7.0))  # type: ignore[valid-type]
    up: within(-1000, 1000) = Distribution(uniform=(-3.0, 3.0))  # type: ignore[valid-type]
    tint: within(0, 3) = Distribution(value=0.2)  # type: ignore[valid-type]

    def draw(self, rng: np.random.Generator) -> tuple[Array, Array]:
        """Draw places, (L, 3) as (across, away, up), and powers, (L, 3) by channel."""
        count = round(self.number.draw(rng))
        axes = (self.across, self.away, self.up)
        places = np.array([[axis.draw(rng) for axis in axes] for _ in range(count)])
        brightness = rng.uniform(0.2, 1.0, (count, 1))
        return places, brightness * np.exp(self.tint.draw(rng) * rng.standard_normal((count, 3)))


class Conditions(Source):
    """Rendered lighting conditions, as `periscopy ambient` makes them, mixed at random."""

    kind: Literal["conditions"]
    names: Files  # or shipped conditions
    mixed: within(1, 100) = Distribution(value=1.0)  # type: ignore[valid-type]
    flip: bool = True  # about the photograph's axes, at random
    target: Annotated[float, Field(gt=1e-6, lt=1)] = 3e-4  # relative error when rendered

    @model_validator(mode="after")
    def _are_distinct(self) -> Conditions:
        if len({Path(name).stem for name in self.names}) < len(self.names):
            raise ValueError("two conditions have one name")
        return self


class Pictures(Source):
    """Photographs of ambient light, such as real ones, of the photographs' size."""

    kind: Literal["pictures"]
    files: Files
    flip: bool = True


class Darkness(Source):
    """No ambient light."""

    kind: Literal["none"]


AmbientSource = Annotated[Lamps | Conditions | Pictures | Darkness, Field(discriminator="kind")]
