"""YAML documents checked by a model; an error names the entry and its line."""

from __future__ import annotations

import re
from pathlib import Path
from typing import Annotated, Any, TypeVar

import yaml
from pydantic import BaseModel, BeforeValidator, ConfigDict, Field, ValidationError

from periscopy_sim.errors import ConfigurationError


class Strict(BaseModel):
    """A part of a document; an entry that it does not know is an error."""

    model_config = ConfigDict(frozen=True, extra="forbid")


def _rows_and_columns(given: Any) -> Any:
    size = re.fullmatch("([0-9]{1,9})x([0-9]{1,9})", str(given), re.IGNORECASE)
    if size is None and not isinstance(given, list | tuple):
        raise ValueError("write ROWSxCOLUMNS, such as 29x36")
    return size.groups() if size else given


Side = Annotated[int, Field(ge=1, le=10_000)]
RowsAndColumns = Annotated[tuple[Side, Side], BeforeValidator(_rows_and_columns)]
"""Rows and columns, written as ROWSxCOLUMNS."""

Document = TypeVar("Document", bound=Strict)


def read_yaml(path: Path, model: type[Document]) -> Document:
    """Return the content of a YAML file as a model whose field `folder` is the file's own.

    A file that is no YAML, or an entry that is unknown, missing or out of range, is a
    `ConfigurationError` with its line.
    """
    try:
        loader = yaml.SafeLoader(path.read_bytes().decode("utf-8-sig"))
        document = loader.get_single_node()
        entries = document and loader.construct_document(document)
    except OSError as error:
        raise ConfigurationError(f"{path}: {error.strerror}; check the path") from None
    except Exception as error:  # PyYAML also raises what Python says of an impossible date
        raise ConfigurationError(f"{path}: {error}; fix the YAML") from None
    if not isinstance(entries, dict) or "folder" in entries:
        raise ConfigurationError(f"{path}: is no mapping of entries as the example is")
    try:
        return model.model_validate({**entries, "folder": path.parent.resolve()})
    except ValidationError as error:
        mistakes = error.errors(include_url=False)
        # A misspelt name first: what it stands for is missing, too.
        first = min(mistakes, key=lambda each: each["type"] != "extra_forbidden")
        known = {"extra_forbidden": "is not known", "missing": "is missing"}
        message = known.get(first["type"], first["msg"].removeprefix("Value error, "))
        place = _place(document, first["loc"], first["type"] == "missing")
        raise ConfigurationError(f"{path}: {place}{message}") from None


def _place(node: Any, location: tuple[int | str, ...], is_missing: bool) -> str:
    """Return the line and the name of the entry that pydantic reports, as the document has it."""
    line, name = 1, ""
    for part in location:
        pairs: list[tuple[Any, Any]] = []
        if isinstance(node, yaml.MappingNode):
            pairs = [pair for pair in node.value if pair[0].value == part]
        elif isinstance(node, yaml.SequenceNode):
            pairs = [(each, each) for k, each in enumerate(node.value) if k == part]
        if pairs:
            line, node = pairs[0][0].start_mark.line + 1, pairs[0][1]
        elif not (is_missing and part == location[-1]):
            continue  # a kind, which pydantic names too
        name += f"[{part}]" if isinstance(part, int) else f".{part}"
    return f"line {line}, {name.lstrip('.')}: " if name else ""
