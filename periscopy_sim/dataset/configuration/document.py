"""What a data set shall hold: a YAML file, checked before anything is rendered."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated, Any, Literal, Self

import yaml
from pydantic import Field, ValidationError, field_validator, model_validator

from periscopy_sim.dataset.configuration.distributions import Distribution, Source, Strict, within
from periscopy_sim.dataset.configuration.hidden_sources import HiddenSource
from periscopy_sim.dataset.configuration.light_sources import AmbientSource
from periscopy_sim.errors import ConfigurationError

EXAMPLE = Path(__file__).with_name("example.yaml")

LARGEST_FILE = 1 << 17
"""Bytes of a configuration; a larger file is something else."""

MOST_ENTRIES = 1 << 16
"""Keys, values and items of a configuration, each counted wherever an alias repeats it."""

_MISTAKES = (  # what PyYAML raises where text is not of its tag's form, or nested too deeply
    RecursionError, ValueError, TypeError, AttributeError, LookupError, ArithmeticError,
)  # fmt: skip

MOST_SAMPLES = 10**8

MOST_GEOMETRIES = 10**5

SPLITS = ("train", "validation", "test")


class SceneSource(Source):
    """A scene, and what varies in it from geometry to geometry.

    Attributes
    ----------
    scene
        A shipped scene's name, or a Mitsuba XML file, as seen from the configuration's folder.
    parameters
        Values for its ``<default>``s: text, a number, or how to draw one.
    version
        Digest of the scene's files, filled in when a data set is made.
    """

    scene: str
    version: str = ""
    parameters: dict[str, Distribution | str] = Field(default_factory=dict)


class Splits(Strict):
    """Shares of the geometries, of sum 1."""

    train: Annotated[float, Field(ge=0)] = 0.8
    validation: Annotated[float, Field(ge=0)] = 0.1
    test: Annotated[float, Field(ge=0)] = 0.1

    @model_validator(mode="after")
    def _sum_to_one(self) -> Self:
        if abs(self.train + self.validation + self.test - 1) > 1e-6:
            raise ValueError("the shares of train, validation and test must sum to 1")
        return self


class Direct(Strict):
    """Photographs A f: light that the wall reflects once, without Monte Carlo noise of their own.

    Attributes
    ----------
    samples
        Samples of a patch for each pixel of A, see `render_transport`.
    """

    kind: Literal["direct"] = "direct"
    samples: Annotated[int, Field(ge=1, le=4096)] = 16


class PathTraced(Strict):
    """Photographs path traced one by one, with light that bounces between all surfaces.

    Attributes
    ----------
    samples
        Samples of a pixel, rounded up to a square number.
    bounces
        Reflections at most; None for any number.
    """

    kind: Literal["path-traced"]
    samples: Annotated[int, Field(ge=1, le=1 << 20)] = 64
    bounces: Annotated[int, Field(ge=1)] | None = None


class Configuration(Strict):
    """A data set's description; ``example.yaml`` beside this file explains each entry.

    Attributes
    ----------
    seed
        Of every random draw: a sample depends on this and on its index alone.
    count
        Samples.
    hidden
        (R, C) of the hidden images.
    samples_per_geometry
        Consecutive samples that share one draw of the scene and its parameters.
    samples_per_shard
        Samples in a file of the archive: what is made, and made again, as a whole.
    clip_length
        Consecutive samples that are frames of one video: the same light, the hidden scene moves.
    splits
        Shares of the geometries that belong to train, validation and test.
    scenes, hidden_images, ambient
        What is drawn from, by weight.
    light
        How photographs come about.
    sbr, snr, exposure
        Signal-to-background ratio, signal-to-noise ratio in dB, and the photograph's mean.
    saturation
        Value at which photographs are clipped; None for no limit.
    photograph_type
        Numbers in which photographs are kept.
    keep_background
        Whether to keep the ambient light of each photograph by itself.
    folder
        Where relative paths start; set by `load_configuration`.
    """

    seed: Annotated[int, Field(strict=True, ge=0, lt=2**31)] = 0
    count: Annotated[int, Field(strict=True, ge=1, le=MOST_SAMPLES)]
    hidden: tuple[int, int]
    samples_per_geometry: Annotated[int, Field(strict=True, ge=1)] = 1000
    samples_per_shard: Annotated[int, Field(strict=True, ge=1, le=1000)] = 50
    clip_length: Annotated[int, Field(strict=True, ge=1)] = 1
    splits: Splits = Splits()
    scenes: Annotated[tuple[SceneSource, ...], Field(min_length=1)]
    hidden_images: Annotated[tuple[HiddenSource, ...], Field(min_length=1)]
    ambient: Annotated[tuple[AmbientSource, ...], Field(min_length=1)]
    light: Annotated[Direct | PathTraced, Field(discriminator="kind")] = Direct()
    sbr: within(1e-6, 1e6) = Distribution(log_uniform=(0.05, 10.0))  # type: ignore[valid-type]
    snr: within(-100, 300) = Distribution(value=60.0)  # type: ignore[valid-type]
    exposure: within(1e-12, 1e12) = Distribution(value=1.0)  # type: ignore[valid-type]
    saturation: Annotated[float, Field(gt=0, allow_inf_nan=False)] | None = None
    photograph_type: Literal["float32", "float16"] = "float32"
    keep_background: bool = False
    folder: Path = Path()

    @field_validator("hidden", mode="before")
    @classmethod
    def _parse_size(cls, given: Any) -> Any:
        if isinstance(given, str):
            rows, _, columns = given.lower().partition("x")
            if rows.isdecimal() and columns.isdecimal() and len(given) < 20:
                return int(rows), int(columns)
        elif isinstance(given, list | tuple):
            return given
        raise ValueError("write ROWSxCOLUMNS, such as 29x36")

    @field_validator("hidden")
    @classmethod
    def _has_patches(cls, given: tuple[int, int]) -> tuple[int, int]:
        if not (1 <= given[0] <= 10_000 and 1 <= given[1] <= 10_000):
            raise ValueError("rows and columns must be from 1 to 10000")
        return given

    @model_validator(mode="after")
    def _divide(self) -> Self:
        if self.samples_per_shard % self.clip_length:
            raise ValueError(
                f"samples_per_shard ({self.samples_per_shard}) must be a multiple of clip_length "
                f"({self.clip_length})"
            )
        if self.samples_per_geometry % self.samples_per_shard:
            raise ValueError(
                f"samples_per_geometry ({self.samples_per_geometry}) must be a multiple of "
                f"samples_per_shard ({self.samples_per_shard})"
            )
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
    path = Path(path)
    try:
        if path.stat().st_size > LARGEST_FILE:
            raise ConfigurationError(f"{path}: is larger than 128 KB; name a YAML configuration")
        text = path.read_bytes().decode("utf-8-sig")
    except OSError as error:
        raise ConfigurationError(f"{path}: {error.strerror}; check the path") from None
    except UnicodeDecodeError:
        raise ConfigurationError(f"{path}: is no text in UTF-8; name a YAML file") from None
    try:
        loader = yaml.SafeLoader(text)
        document = loader.get_single_node()
        if _size(document, {}) > MOST_ENTRIES:
            raise ConfigurationError(
                f"{path}: holds more than {MOST_ENTRIES} entries, aliases followed; write fewer"
            )
        entries = None if document is None else loader.construct_document(document)
    except ConfigurationError:
        raise
    except yaml.YAMLError as error:
        raise ConfigurationError(
            f"{path}{_place(error)}: {_problem(error)}; fix the YAML"
        ) from None
    except _MISTAKES as error:
        raise ConfigurationError(f"{path}: cannot be read as YAML: {error}") from None
    if not isinstance(entries, dict):
        raise ConfigurationError(f"{path}: holds no entries; see 'periscopy dataset --example'")
    if "folder" in entries:
        raise ConfigurationError(f"{path}: 'folder' is this file's own; leave it out")
    try:
        return Configuration.model_validate({**entries, "folder": path.parent.resolve()})
    except (ValidationError, RecursionError) as error:
        raise ConfigurationError(f"{path}: {_first_mistake(error, document)}") from None


def _size(node: yaml.Node | None, known: dict[yaml.Node, int]) -> int:
    """Return the number of entries of a document, those of an anchor again at each of its aliases.

    Refuses keys given twice, of which YAML readers commonly keep the last.
    """
    if node is None:
        return 0
    if node in known:
        if known[node] == 0:
            raise ValueError("an alias stands within its own anchor")
        return known[node]
    known[node] = 0  # being counted
    inner: list[yaml.Node] = []
    if isinstance(node, yaml.MappingNode):
        given: set[str] = set()
        for key, value in node.value:
            inner += [key, value]
            if isinstance(key, yaml.ScalarNode) and key.value != "<<":
                if key.value in given:
                    raise yaml.MarkedYAMLError(
                        problem=f"'{key.value}' is given twice", problem_mark=key.start_mark
                    )
                given.add(key.value)
    elif isinstance(node, yaml.SequenceNode):
        inner = node.value
    known[node] = 1 + sum(_size(entry, known) for entry in inner)
    return known[node]


def _place(error: yaml.YAMLError) -> str:
    mark = getattr(error, "problem_mark", None)
    return f", line {mark.line + 1}" if mark else ""


def _problem(error: yaml.YAMLError) -> str:
    return str(getattr(error, "problem", None) or error).splitlines()[0]


def _first_mistake(error: ValidationError | RecursionError, document: yaml.Node | None) -> str:
    """Return the first of pydantic's complaints in words, with its line."""
    if isinstance(error, RecursionError):
        return "is nested too deeply"
    mistakes = error.errors(include_url=False, include_context=False, include_input=False)
    first = mistakes[0]
    known, line = _located(document, first["loc"])
    entry = ".".join(str(part) for part in known)
    message = first["msg"].removeprefix("Value error, ")
    message = _IN_WORDS.get(first["type"], message)
    if first["type"] == "extra_forbidden":
        message = "is not known; see 'periscopy dataset --example'"
    elif first["type"] == "missing":
        entry, message = ".".join(str(part) for part in first["loc"]), "is missing"
    more = f" (and {len(mistakes) - 1} more)" if len(mistakes) > 1 else ""
    return f"line {line}, {entry}: {message}{more}" if entry else f"{message}{more}"


_IN_WORDS = {
    "union_tag_not_found": "has no 'kind'",
    "tuple_type": "give a list",
    "list_type": "give a list",
    "dict_type": "give entries, NAME: VALUE",
    "model_type": "give entries, NAME: VALUE",
    "too_long": "holds too many",
}
"""Where pydantic's words are a programmer's."""


def _located(node: Any, location: tuple[int | str, ...]) -> tuple[list[int | str], int]:
    """Return the known part of pydantic's location in the document, and its line."""
    line, found = 1, []
    for part in location:
        if isinstance(node, yaml.MappingNode):
            inside = next((pair for pair in node.value if pair[0].value == part), None)
            if inside is None:
                continue
            line, node = inside[0].start_mark.line + 1, inside[1]
        elif isinstance(node, yaml.SequenceNode) and isinstance(part, int):
            if part >= len(node.value):
                continue
            node = node.value[part]
            line = node.start_mark.line + 1
        else:
            continue
        found.append(part)
    return found, line
