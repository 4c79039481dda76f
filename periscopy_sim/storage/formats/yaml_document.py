"""YAML documents checked by a model: what is misspelt, missing or wrong is told with its line."""

from __future__ import annotations

import re
from pathlib import Path
from typing import Annotated, Any, TypeVar, get_args

import yaml
from pydantic import (
    BaseModel,
    BeforeValidator,
    ConfigDict,
    Field,
    ValidationError,
    ValidationInfo,
    model_validator,
)
from pydantic_core import PydanticCustomError

from periscopy_sim.errors import ConfigurationError, did_you_mean

LARGEST_FILE = 1 << 17
"""Bytes of a document; a larger file is something else."""

MOST_ENTRIES = 1 << 16
"""Keys, values and items of a document, each counted wherever an alias repeats it."""

_MISTAKES = (  # what PyYAML raises where text is not of its tag's form, or nested too deeply
    RecursionError, ValueError, TypeError, AttributeError, LookupError, ArithmeticError,
)  # fmt: skip


class Strict(BaseModel):
    """A part of a document: an entry that it does not know is refused."""

    model_config = ConfigDict(frozen=True)

    @model_validator(mode="before")
    @classmethod
    def _knows(cls, given: Any, info: ValidationInfo) -> Any:
        known = cls.entries()
        for name in given if isinstance(given, dict) else ():
            if name not in known:
                example = (info.context or {}).get("example", "its documentation")
                told = {"entry": str(name), "advice": cls._advice(str(name), example)}
                raise PydanticCustomError("unknown", "is not known{advice}", told)
        return given

    @classmethod
    def entries(cls) -> list[str]:
        """Return the names of the entries, as a document has them."""
        return [field.alias or name for name, field in cls.model_fields.items()]

    @classmethod
    def _advice(cls, name: str, example: str) -> str:
        """Return what to write in the place of an entry that is not known."""
        own = _kind(cls)
        owners = [_kind(other) for other in _siblings(cls) if name in other.entries()]
        if own and owners:
            return f" of kind {own}; it belongs to kind {' and '.join(map(str, owners))}"
        if meant := did_you_mean(name, cls.entries()):
            return f"; {meant}"
        known = ", ".join(each for each in cls.entries() if each not in ("kind", "folder"))
        return f"; {f'kind {own} has' if own else 'there are'} {known}; see {example}"


def _kind(model: type[Strict]) -> str | None:
    """Return the kind of what a model describes, where there are several."""
    kind = model.model_fields.get("kind")
    return None if kind is None else next(iter(get_args(kind.annotation)), None)


def _siblings(model: type[Strict]) -> list[type[Strict]]:
    """Return the models of the other kinds: those that share a base with it."""
    family = next(each for each in reversed(model.__mro__) if Strict in each.__bases__)
    found, waiting = [], [family]
    while waiting:
        each = waiting.pop(0)
        waiting += each.__subclasses__()
        if each is not model and _kind(each):
            found.append(each)
    return found


def _rows_and_columns(given: Any) -> Any:
    size = re.fullmatch("([0-9]{1,9})x([0-9]{1,9})", str(given), re.IGNORECASE)
    if size is None and not isinstance(given, list | tuple):
        raise ValueError("write ROWSxCOLUMNS, such as 29x36")
    return size.groups() if size else given


Side = Annotated[int, Field(ge=1, le=10_000)]
RowsAndColumns = Annotated[tuple[Side, Side], BeforeValidator(_rows_and_columns)]
"""Rows and columns, written as ROWSxCOLUMNS."""

Document = TypeVar("Document", bound=Strict)


def read_yaml(path: Path, model: type[Document], example: str) -> Document:
    """Return what a YAML file holds, as a model whose field `folder` is the file's own.

    `example` is the command that prints an example, for messages. A file that is no YAML, or an
    entry that is unknown, missing or out of range, is a `ConfigurationError` with its line.
    """
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
        raise ConfigurationError(f"{path}: holds no entries; see '{example}'")
    if "folder" in entries:
        raise ConfigurationError(f"{path}: 'folder' is this file's own; leave it out")
    entries["folder"] = path.parent.resolve()
    example = f"'{example}'"
    try:
        return model.model_validate(entries, context={"example": example})
    except ValidationError as error:
        raise ConfigurationError(f"{path}: {_first_mistake(error, document, example)}") from None
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


def _first_mistake(error: ValidationError, document: yaml.Node | None, example: str) -> str:
    """Return the first of pydantic's complaints in words, with its line; misspelt names first."""
    told = sorted(error.errors(include_url=False), key=lambda each: each["type"] != "unknown")
    places = [_located(document, each) for each in told]
    (entry, line), others = places[0], {place for place, _ in places}
    message = told[0]["msg"].removeprefix("Value error, ")
    if told[0]["type"] in _IN_WORDS:
        message = _IN_WORDS[told[0]["type"]].format_map(
            {"example": example, **told[0].get("ctx", {})}
        )
    # What holds the first mistake is wrong by that alone.
    more = sum(entry[: len(place)] != place for place in others)
    place = f"line {line}, {_as_counted(document, entry)}: " if entry else ""
    return place + message + (f" (and {more} more)" if more else "")


_IN_WORDS = {
    "missing": "is missing",
    "union_tag_not_found": "has no 'kind'; see {example}",
    "union_tag_invalid": "kind '{tag}' is not known; there are {expected_tags}",
    "tuple_type": "give a list",
    "dict_type": "give entries, NAME: VALUE",
    "model_type": "give entries, NAME: VALUE",
    "model_attributes_type": "give entries, NAME: VALUE",
    "too_long": "holds {actual_length}, at most {max_length} belong there; decimals take a point",
}
"""Where pydantic's words are a programmer's."""

_ORDINALS = (
    "first", "second", "third", "fourth", "fifth", "sixth", "seventh", "eighth", "ninth", "tenth",
)  # fmt: skip


def _as_counted(node: Any, entry: tuple[int | str, ...]) -> str:
    """Return an entry in words; those of lists are counted from 1 and called by name or kind."""
    found = [""]
    for part in entry:
        node = _within(node, part)[1]
        if isinstance(part, str):
            found[-1] += f".{part}" if found[-1] else part
        else:
            count = f"the {_ORDINALS[part]}" if part < len(_ORDINALS) else f"number {part + 1}"
            called = _scalar(node, "name") or _scalar(node, "kind")
            found[-1] = f"{count} of {found[-1] or 'these'}" + (f" ('{called}')" if called else "")
            found.append("")
    return ", ".join(filter(None, found))


def _located(node: Any, mistake: Any) -> tuple[tuple[int | str, ...], int]:
    """Return what pydantic complains of, as the document names it, and its line."""
    unknown = mistake.get("ctx", {}).get("entry")
    location = (*mistake["loc"], unknown) if unknown else mistake["loc"]
    line, found, kind = 1, [], None
    for part in location:
        if part == kind:  # which pydantic names, too: no entry, though there may be one named so
            kind = None
            continue
        key, inside = _within(node, part)
        if key is not None:
            node, line = inside, key.start_mark.line + 1
            found.append(part)
            kind = _scalar(node, "kind")
    if mistake["type"] in ("missing", "unknown") and location[-1] not in found[-1:]:
        found.append(location[-1])
    return tuple(found), line


def _within(node: Any, part: int | str) -> tuple[Any, Any]:
    """Return the key and the node of an entry of a mapping or a list; None where there is none."""
    inside: list[tuple[yaml.Node, yaml.Node]] = []
    if isinstance(node, yaml.MappingNode):
        inside = [pair for pair in node.value if pair[0].value == part]
    elif isinstance(node, yaml.SequenceNode) and isinstance(part, int):
        inside = [(each, each) for each in node.value[part : part + 1]]
    return inside[0] if inside else (None, None)


def _scalar(node: Any, name: str) -> str | None:
    """Return the text of an entry of a mapping; None where it has none."""
    value = _within(node, name)[1]
    return value.value if isinstance(value, yaml.ScalarNode) else None
