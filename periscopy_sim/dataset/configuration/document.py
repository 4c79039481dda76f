"""What a data set shall hold: a YAML file, checked before anything is rendered."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated, Literal, Self

from pydantic import Field, FiniteFloat, NonNegativeFloat, model_validator

from periscopy_sim.dataset.configuration.distributions import Distribution, Source, within
from periscopy_sim.dataset.configuration.hidden_sources import HiddenSource
from periscopy_sim.dataset.configuration.light_sources import AmbientSource
from periscopy_sim.storage.formats.yaml_document import RowsAndColumns, Strict, read_yaml

EXAMPLE = Path(__file__).with_name("example.yaml")

MOST_SAMPLES = 10**8

MOST_GEOMETRIES = 10**5

SPLITS = ("train", "validation", "test")


Count = Annotated[int, Field(strict=True, ge=1)]


class SceneSource(Source):
    """A scene, and what varies in it from geometry to geometry."""

    scene: str
    version: str = ""  # digest of the scene's files, filled in when a data set is made
    parameters: dict[str, Distribution | str] = Field(default_factory=dict)


class Splits(Strict):
    """Shares of the geometries, of sum 1."""

    train: NonNegativeFloat = 0.8
    validation: NonNegativeFloat = 0.1
    test: NonNegativeFloat = 0.1

    @model_validator(mode="after")
    def _sum_to_one(self) -> Self:
        if abs(self.train + self.validation + self.test - 1) > 1e-6:
            raise ValueError("the shares of train, validation and test must sum to 1")
        return self


class Direct(Strict):
    """Photographs A f: light that the wall reflects once, without Monte Carlo noise of its own."""

    kind: Literal["direct"] = "direct"
    samples: Annotated[int, Field(ge=1, le=4096)] = 16  # of a patch, see `render_transport`


class Bounced(Strict):
    """Photographs A f with light that bounces between all surfaces, hardly noisy of their own."""

    kind: Literal["bounced"]
    samples: Annotated[int, Field(ge=1, le=4096)] = 16
    bounces: Annotated[int, Field(ge=2, le=10**6)] | None = None  # reflections at most


class PathTraced(Strict):
    """Photographs path traced one by one, with light that bounces between all surfaces."""

    kind: Literal["path-traced"]
    samples: Annotated[int, Field(ge=1, le=1 << 20)] = 64  # rounded up to a square number
    bounces: Annotated[int, Field(ge=1)] | None = None


class Configuration(Strict):
    """A data set's description; ``example.yaml`` beside this file explains each entry.

    `folder`, where relative paths start, is set by `load_configuration`.
    """

    seed: Annotated[int, Field(strict=True, ge=0, lt=2**31)] = 0
    count: Annotated[Count, Field(le=MOST_SAMPLES)]
    hidden: RowsAndColumns
    samples_per_geometry: Count = 1000
    samples_per_shard: Annotated[Count, Field(le=1000)] = 50
    clip_length: Count = 1
    splits: Splits = Splits()
    scenes: Annotated[tuple[SceneSource, ...], Field(min_length=1)]
    hidden_images: Annotated[tuple[HiddenSource, ...], Field(min_length=1)]
    ambient: Annotated[tuple[AmbientSource, ...], Field(min_length=1)]
    light: Annotated[Direct | Bounced | PathTraced, Field(discriminator="kind")] = Direct()
    sbr: within(1e-6, 1e6) = Distribution(log_uniform=(0.05, 10.0))  # type: ignore[valid-type]
    snr: within(-100, 300) = Distribution(value=60.0)  # type: ignore[valid-type]
    exposure: within(1e-12, 1e12) = Distribution(value=1.0)  # type: ignore[valid-type]
    saturation: Annotated[FiniteFloat, Field(gt=0)] | None = None
    photograph_type: Literal["float32", "float16"] = "float32"
    keep_background: bool = False
    folder: Path = Path()

    @model_validator(mode="after")
    def _divide(self) -> Self:
        for whole, part in (
            ("samples_per_shard", "clip_length"),
            ("samples_per_geometry", "samples_per_shard"),
        ):
            size, of = getattr(self, whole), getattr(self, part)
            if size % of:
                raise ValueError(f"{whole} ({size}) must be a multiple of {part} ({of})")
        if self.geometries > MOST_GEOMETRIES:
            raise ValueError(
                f"{self.count} samples are of {self.geometries} geometries, more than "
                f"{MOST_GEOMETRIES}; raise samples_per_geometry"
            )
        if self.photograph_type == "float16" and self.exposure.bounds[1] > 100:
            raise ValueError("an exposure above 100 may not fit float16; use float32")
        return self

    @property
    def geometries(self) -> int:
        """Return the number of geometries; the last may be cut short."""
        return -(-self.count // self.samples_per_geometry)


def load_configuration(path: str | Path) -> Configuration:
    """Read a data set's configuration.

    Parameters
    ----------
    path
        A YAML file.

    Returns
    -------
    Configuration

    Raises
    ------
    ConfigurationError
        If it is no YAML, or an entry is unknown, missing or out of range; with its line.
    """
    return read_yaml(Path(path), Configuration, "periscopy dataset --example")
