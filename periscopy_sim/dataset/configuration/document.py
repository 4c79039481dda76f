"""What a data set shall hold: a YAML file, checked before anything is rendered."""

from __future__ import annotations

import re
from pathlib import Path
from typing import Annotated, Any, Literal, Self

import yaml
from pydantic import (
    BeforeValidator,
    Field,
    FiniteFloat,
    NonNegativeFloat,
    ValidationError,
    model_validator,
)

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


def _rows_and_columns(given: Any) -> Any:
    size = re.fullmatch("([0-9]{1,9})x([0-9]{1,9})", str(given), re.IGNORECASE)
    if size is None and not isinstance(given, list | tuple):
        raise ValueError("write ROWSxCOLUMNS, such as 29x36")
    return size.groups() if size else given


Count = Annotated[int, Field(strict=True, ge=1)]
Side = Annotated[int, Field(ge=1, le=10_000)]
Size = Annotated[tuple[Side, Side], BeforeValidator(_rows_and_columns)]


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
    hidden: Size
    samples_per_geometry: Count = 1000
    samples_per_shard: Annotated[Count, Field(le=1000)] = 50
    clip_length: Count = 1
    splits: Splits = Splits()
    scenes: Annotated[tuple[SceneSource, ...], Field(min_length=1)]
    hidden_images: Annotated[tuple[HiddenSource, ...], Field(min_length=1)]
    ambient: Annotated[tuple[AmbientSource, ...], Field(min_length=1)]
    light: Annotated[Direct | PathTraced, Field(discriminator="kind")] = Direct()
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
        if document is not None and _count_entries(document, {}) > MOST_ENTRIES:
            raise yaml.YAMLError(f"holds more than {MOST_ENTRIES} entries, aliases followed")
        entries = document and loader.construct_document(document)
    except yaml.YAMLError as error:
        mark = getattr(error, "problem_mark", None)
        place = f", line {mark.line + 1}" if mark else ""
        problem = str(getattr(error, "problem", None) or error).splitlines()[0]
        raise ConfigurationError(f"{path}{place}: {problem}; fix the YAML") from None
    except _MISTAKES as error:
        raise ConfigurationError(f"{path}: cannot be read as YAML: {error}") from None
    if not isinstance(entries, dict):
        raise ConfigurationError(f"{path}: holds no entries; see 'periscopy dataset --example'")
    if "folder" in entries:
        raise ConfigurationError(f"{path}: 'folder' is this file's own; leave it out")
    try:
        return Configuration.model_validate({**entries, "folder": path.parent.resolve()})
    except ValidationError as error:
        raise ConfigurationError(f"{path}: {_first_mistake(error, document)}") from None
    except RecursionError:
        raise ConfigurationError(f"{path}: is nested too deeply; fix the YAML") from None


def _count_entries(node: yaml.Node, known: dict[yaml.Node, int]) -> int:
    """Return the number of entries of a document, those of an anchor again at each of its aliases.

    Refuses keys given twice, of which YAML readers commonly keep the last.
    """
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
    known[node] = 1 + sum(_count_entries(entry, known) for entry in inner)
    return known[node]


def _first_mistake(error: ValidationError, document: yaml.Node | None) -> str:
    """Return the first of pydantic's complaints in words, with its line; misspelt names first."""
    told = sorted(error.errors(include_url=False), key=lambda each: each["type"] != "unknown")
    places = [_located(document, each) for each in told]
    (entry, line), others = places[0], {place for place, _ in places}
    message = told[0]["msg"].removeprefix("Value error, ")
    if told[0]["type"] in _IN_WORDS:
        message = _IN_WORDS[told[0]["type"]].format_map(told[0].get("ctx", {}))
    # What holds the first mistake is wrong by that alone.
    more = sum(entry[: len(place)] != place for place in others)
    place = f"line {line}, {'.'.join(map(str, entry))}: " if entry else ""
    return place + message + (f" (and {more} more)" if more else "")


_IN_WORDS = {
    "missing": "is missing",
    "union_tag_not_found": "has no 'kind'; see 'periscopy dataset --example'",
    "union_tag_invalid": "kind '{tag}' is not known; there are {expected_tags}",
    "tuple_type": "give a list",
    "dict_type": "give entries, NAME: VALUE",
    "model_type": "give entries, NAME: VALUE",
    "model_attributes_type": "give entries, NAME: VALUE",
    "too_long": "holds too many",
}
"""Where pydantic's words are a programmer's."""


def _located(node: Any, mistake: Any) -> tuple[tuple[int | str, ...], int]:
    """Return what pydantic complains of, as the document names it, and its line."""
    unknown = mistake.get("ctx", {}).get("entry")
    location = (*mistake["loc"], unknown) if unknown else mistake["loc"]
    line, found, kind = 1, [], None
    for part in location:
        if part == kind:  # which pydantic names, too: no entry, though there may be one named so
            kind = None
            continue
        inside: list[tuple[yaml.Node, yaml.Node]] = []
        if isinstance(node, yaml.MappingNode):
            inside = [pair for pair in node.value if pair[0].value == part]
        elif isinstance(node, yaml.SequenceNode) and isinstance(part, int):
            inside = [(each, each) for each in node.value[part : part + 1]]
        if inside:
            key, node = inside[0]
            line = key.start_mark.line + 1
            found.append(part)
            entries = node.value if isinstance(node, yaml.MappingNode) else []
            kind = next((value.value for name, value in entries if name.value == "kind"), None)
    if mistake["type"] in ("missing", "unknown") and location[-1] not in found[-1:]:
        found.append(location[-1])
    return tuple(found), line
