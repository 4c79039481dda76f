"""The description of a data set: a YAML file, checked before anything is rendered."""

from pathlib import Path
from typing import Annotated, Any, Literal, Self

import numpy as np
from pydantic import Field, model_validator

from periscopy_sim.dataset.distributions import Distribution, Source, within
from periscopy_sim.dataset.hidden_sources import HiddenSource
from periscopy_sim.dataset.reading import CHANNELS, Size
from periscopy_sim.numerics import Array
from periscopy_sim.photograph import ColourMatrix
from periscopy_sim.shipped import find_condition, find_scene
from periscopy_sim.storage.formats.yaml_document import Number, Sizes, Strict, ranged, read_yaml
from periscopy_sim.storage.outputs.provenance import scene_sha256, sha256_of

EXAMPLE = Path(__file__).with_name("example.yaml")

SPLITS = ("train", "validation", "test")

Triple = tuple[Number, Number, Number]

Files = Annotated[tuple[str, ...], Field(min_length=1)]
"""Paths, relative to the configuration's folder."""


class SceneSource(Source):
    """A scene, and what varies in it from geometry to geometry."""

    scene: str
    version: str = ""  # digest of the scene's files, filled in when a data set is made
    parameters: dict[str, Distribution | str] = Field(default_factory=dict)

    def located(self, folder: Path) -> Self:
        """Return the source with the absolute path of its scene and the digest of its files."""
        beside = folder / self.scene
        path = (beside if beside.is_file() else find_scene(self.scene)).resolve()
        return self.model_copy(update={"scene": str(path), "version": scene_sha256(path)})

    def identity(self) -> dict[str, Any]:
        """Return the name of the scene."""
        return {"scene": Path(self.scene).stem}


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


class Mixture(Source):
    """Pictures of ambient light of the photographs' size, of which some are drawn and added."""

    mixed: within(1, 100) = Distribution(value=1.0)  # type: ignore[valid-type]
    flip: bool = True  # about the photograph's axes, at random


class Conditions(Mixture):
    """Lighting conditions, rendered as `periscopy ambient` does, on the first geometry's wall."""

    kind: Literal["conditions"]
    names: Files  # or shipped conditions
    target: Annotated[float, ranged("error")] = 3e-4  # relative error when rendered

    def located(self, folder: Path) -> Self:
        """Return the source with absolute paths of the conditions that are not shipped."""
        beside = [(folder / name).resolve() for name in self.names]
        names = [str(p) if p.is_file() else n for p, n in zip(beside, self.names, strict=True)]
        return self.model_copy(update={"names": tuple(names)})

    def identity(self) -> dict[str, Any]:
        """Return names and digests of the conditions."""
        digests = [scene_sha256(find_condition(name)) for name in self.names]
        return {"names": [Path(name).stem for name in self.names], "sha256": digests}


class Pictures(Mixture):
    """Photographs of ambient light, such as real ones."""

    kind: Literal["pictures"]
    files: Files

    def located(self, folder: Path) -> Self:
        """Return the source with absolute paths."""
        files = tuple(str((folder / name).resolve()) for name in self.files)
        return self.model_copy(update={"files": files})

    def identity(self) -> dict[str, Any]:
        """Return the names of the files and the digest of all of them."""
        names = [Path(name).name for name in self.files]
        return {"files": names, "sha256": sha256_of(map(Path, self.files))}


class Darkness(Source):
    """No ambient light."""

    kind: Literal["none"]


AmbientSource = Annotated[Lamps | Conditions | Pictures | Darkness, Field(discriminator="kind")]


Share = Annotated[Number, Field(ge=0, le=1)]


class Splits(Strict):
    """Shares of the geometries, of sum 1."""

    train: Share = 0.8
    validation: Share = 0.1
    test: Share = 0.1

    @model_validator(mode="after")
    def _sum_to_one(self) -> Self:
        if abs(self.train + self.validation + self.test - 1) > 1e-6:
            raise ValueError("the shares of train, validation and test must sum to 1")
        return self


Rays = Annotated[int, ranged("rays")]


class Direct(Strict):
    """Photographs A f: light that the wall reflects once; A errs less than their noise."""

    kind: Literal["direct"] = "direct"
    samples: Rays | None = None  # from each pixel's centre to each patch; None: see `planned`


class Bounced(Strict):
    """Photographs A f with light that bounces between all surfaces, hardly noisy of their own."""

    kind: Literal["bounced"]
    samples: Rays | None = None
    bounces: Annotated[int, ranged("bounces"), Field(ge=2)] | None = None  # reflections at most


class Configuration(Strict):
    """A data set's description; ``example.yaml`` beside this file explains each entry.

    `folder`, where relative paths start, is set by `load_configuration`.
    """

    seed: Annotated[int, ranged("seed")] = 0
    count: Size
    hidden: Sizes
    samples_per_geometry: Size = 1000
    samples_per_shard: Annotated[int, ranged("count")] = 50
    clip_length: Size = 1
    splits: Splits = Splits()
    scenes: Annotated[tuple[SceneSource, ...], Field(min_length=1)]
    hidden_images: Annotated[tuple[HiddenSource, ...], Field(min_length=1)]
    ambient: Annotated[tuple[AmbientSource, ...], Field(min_length=1)]
    light: Annotated[Direct | Bounced, Field(discriminator="kind")] = Direct()
    sbr: within("ratio") = Distribution(log_uniform=(0.05, 10.0))  # type: ignore[valid-type]
    snr: within("decibels") = Distribution(value=60.0)  # type: ignore[valid-type]
    exposure: within("exposure") = Distribution(value=1.0)  # type: ignore[valid-type]
    colour_matrix: Annotated[tuple[Triple, ...], Field(min_length=3)] | None = None
    saturation: Annotated[Number, Field(gt=0)] | None = None
    photograph_type: Literal["float32", "float16"] = "float32"
    keep_background: bool = False
    folder: Path = Path()

    @model_validator(mode="after")
    def _is_consistent(self) -> Self:
        self.colours  # noqa: B018  raises where the matrix mixes colours up
        for whole, part in (
            ("samples_per_shard", "clip_length"),
            ("samples_per_geometry", "samples_per_shard"),
        ):
            size, of = getattr(self, whole), getattr(self, part)
            if size % of:
                raise ValueError(f"{whole} ({size}) must be a multiple of {part} ({of})")
        return self

    @property
    def colours(self) -> ColourMatrix | None:
        """From the monitor's primaries to the camera's channels; None for the identity."""
        return None if self.colour_matrix is None else ColourMatrix(np.array(self.colour_matrix))

    @property
    def channels(self) -> int:
        """Return the number of the camera's channels."""
        return len(self.colour_matrix or CHANNELS)

    @property
    def geometries(self) -> int:
        """Return the number of geometries; the last may be cut short."""
        return -(-self.count // self.samples_per_geometry)

    @property
    def sources(self) -> dict[str, tuple[Source, ...]]:
        """Return the lists that are drawn from, by their entries' names."""
        lists = {"hidden_images": self.hidden_images, "ambient": self.ambient}
        return {**lists, "scenes": self.scenes}

    def located(self) -> "Configuration":
        """Return the configuration with absolute paths; an error names one that does not exist."""
        lists = {
            name: tuple(source.located(self.folder) for source in sources)
            for name, sources in self.sources.items()
        }
        return self.model_copy(update=lists)

    def identity(self) -> dict[str, Any]:
        """Return all entries that a sample depends on, of JSON's types, without paths."""
        entries = self.model_dump(mode="json", exclude={"count", "folder"})
        if self.colour_matrix is None:
            del entries["colour_matrix"]  # older data sets have none
        for name, sources in self.sources.items():
            for entry, source in zip(entries[name], sources, strict=True):
                entry |= source.identity()
        return entries


def load_configuration(path: str | Path) -> Configuration:
    """Read a data set's configuration, a YAML file.

    A file that is no YAML is a `ConfigurationError`; so is an entry that is unknown, missing or out
    of range, with its line.
    """
    return read_yaml(Path(path), Configuration)
