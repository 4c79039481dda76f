"""YAML documents checked by a model; an error names the entry and its line."""

from pathlib import Path
from typing import Annotated, Any, TypeVar

import pydantic
from pydantic_core import PydanticCustomError
from ruamel.yaml import YAML
from ruamel.yaml.nodes import MappingNode, Node, SequenceNode

from periscopy_sim.errors import ConfigurationError, did_you_mean, in_words, path_fault
from periscopy_sim.numerics.validation import RANGES, read_regular, size_of

MOST_BYTES = 1 << 17
"""Bytes of a YAML file. At worst, of a list of digits, it takes 6 s to parse."""

UNKNOWN = "extra_forbidden"
"""Pydantic's type of a mistake: an entry that a model does not know."""


class Strict(pydantic.BaseModel):
    """A part of a document; an entry that it does not know is an error."""

    model_config = pydantic.ConfigDict(frozen=True, extra="forbid")

    @pydantic.model_validator(mode="wrap")
    @classmethod
    def _knows(cls, value: Any, check: Any) -> Any:
        try:
            return check(value)
        except pydantic.ValidationError as error:
            mistakes: list[Any] = error.errors(include_url=False)
        fields = cls.model_fields.items()
        known = [field.alias or name for name, field in fields if name != "folder"]
        # A misspelt name first: what it stands for is missing, too.
        mistakes = sorted(mistakes, key=lambda each: each["type"] != UNKNOWN)
        for each in mistakes:
            if each["type"] == UNKNOWN and len(each["loc"]) == 1:
                advice = did_you_mean(str(*each["loc"]), known) or f"there are {', '.join(known)}"
                each["msg"] = f"is not known; {advice}"
            custom = PydanticCustomError(each["type"], "{text}", {"text": each["msg"]})
            each |= {"type": custom, "input": None}
        raise pydantic.ValidationError.from_exception_data(cls.__name__, mistakes)


def text_of(value: Any) -> str:
    """Return a text or a number as text, cut short; of anything else, maybe huge, its type."""
    text = str(value) if isinstance(value, str | int | float) else type(value).__name__
    return text if len(text) < 200 else f"{text[:200]} ..."


Number = Annotated[float, pydantic.Field(strict=True, allow_inf_nan=False)]
"""A finite number, no text or truth value."""


def ranged(kind: str) -> Any:
    """Return the limits of a field that is a number of a kind in `RANGES`."""
    return pydantic.Field(strict=True, ge=RANGES[kind].least, le=RANGES[kind].most)


RowsAndColumns = Annotated[tuple[int, int], pydantic.BeforeValidator(size_of)]
"""Rows and columns, written as ROWSxCOLUMNS or [ROWS, COLUMNS]."""

Sizes = Annotated[
    Annotated[RowsAndColumns, pydantic.Tag("one")]
    | Annotated[dict[str, RowsAndColumns], pydantic.Tag("several")],
    pydantic.Discriminator(lambda value: "several" if isinstance(value, dict) else "one"),
]
"""Rows and columns of the only hidden surface, or of each by its id."""

Document = TypeVar("Document", bound=Strict)


def read_yaml(path: Path, model: type[Document], *, as_texts: bool = False) -> Document:
    """Return the content of a file of YAML 1.2 as a model whose field `folder` is the file's own.

    With `as_texts`, numbers and truth values stay the texts that the file has. A file that is no
    YAML is a `ConfigurationError`, and so are entries that are unknown, missing or out of range,
    all of them with their lines.
    """
    yaml = YAML(typ="base" if as_texts else "safe", pure=True)
    try:
        document = yaml.compose(read_regular(path, MOST_BYTES))
        entries = document and yaml.constructor.construct_document(document)
    except OSError as error:
        fault = path_fault(path) or f"{error.strerror}; check the path"
        raise ConfigurationError(f"{path}: {fault}") from None
    except Exception as error:  # the reader also raises what Python says of a huge integer
        mark = getattr(error, "problem_mark", None)
        place = f", line {mark.line + 1}" if mark else ""
        problem = str(getattr(error, "problem", None) or error).splitlines()[0]
        raise ConfigurationError(f"{path}{place}: {problem}; fix the YAML") from None
    if not isinstance(entries, dict) or "folder" in entries:
        raise ConfigurationError(f"{path}: is no mapping of entries as the example is")
    try:
        return model.model_validate({**entries, "folder": path.parent.resolve()})
    except pydantic.ValidationError as error:
        # A list whose entry is wrong is too short, too.
        faults = error.errors()
        faults = [each for each in faults if each["type"] != "too_short"] or faults
        messages = [_located(document, each) + in_words(each["msg"]) for each in faults]
        raise ConfigurationError(f"{path}: {'; '.join(dict.fromkeys(messages))}") from None


def _located(node: Node | None, mistake: Any) -> str:
    """Return the line and the name of the entry that pydantic reports, as the document has it."""
    line, name = 1, ""
    for part in mistake["loc"]:
        pairs: list[tuple[Any, Any]] = []
        if isinstance(node, MappingNode):
            pairs = [pair for pair in node.value if pair[0].value == str(part)]
        elif isinstance(node, SequenceNode):
            pairs = [(each, each) for k, each in enumerate(node.value) if k == part]
        if pairs:
            line, node = pairs[-1][0].start_mark.line + 1, pairs[-1][1]
        elif part != mistake["loc"][-1] or mistake["type"] != "missing":
            continue  # a kind, which pydantic names too
        name += f"[{part}]" if isinstance(part, int) else f".{part}"
    return f"line {line}, {name.lstrip('.')}: " if name else ""
