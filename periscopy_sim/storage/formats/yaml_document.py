"""YAML documents checked by a model; an error names the entry and its line."""

import math
from collections import Counter
from pathlib import Path
from typing import Annotated, Any, TypeVar

import yaml
from pydantic import (
    BaseModel,
    BeforeValidator,
    ConfigDict,
    Discriminator,
    Field,
    Tag,
    ValidationError,
    model_validator,
)
from pydantic_core import PydanticCustomError

from periscopy_sim.errors import ConfigurationError, did_you_mean, path_fault
from periscopy_sim.numerics.limits import read_regular, size_of

MOST_LETTERS = 1 << 17
"""Bytes of a YAML file, and its letters and entries once aliases are filled in: 1 s of parsing."""

UNKNOWN = "extra_forbidden"
"""Pydantic's type of a mistake: an entry that a model does not know."""


class Strict(BaseModel):
    """A part of a document; an entry that it does not know is an error."""

    model_config = ConfigDict(frozen=True, extra="forbid")

    @model_validator(mode="wrap")
    @classmethod
    def _knows(cls, value: Any, check: Any) -> Any:
        try:
            return check(value)
        except ValidationError as error:
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
        raise ValidationError.from_exception_data(cls.__name__, mistakes)


def text_of(value: Any) -> str:
    """Return a text or a number as text, cut short; of anything else, maybe huge, its type."""
    text = str(value) if isinstance(value, str | int | float) else type(value).__name__
    return text if len(text) < 200 else f"{text[:200]} ..."


def _rows_and_columns(value: Any) -> Any:
    return value if isinstance(value, list | tuple) else size_of(text_of(value))


Side = Annotated[int, Field(ge=1, le=10_000)]
RowsAndColumns = Annotated[tuple[Side, Side], BeforeValidator(_rows_and_columns)]
"""Rows and columns, written as ROWSxCOLUMNS."""

Sizes = Annotated[
    Annotated[RowsAndColumns, Tag("one")] | Annotated[dict[str, RowsAndColumns], Tag("several")],
    Discriminator(lambda value: "several" if isinstance(value, dict) else "one"),
]
"""Rows and columns of the only hidden surface, or of each by its id."""

Document = TypeVar("Document", bound=Strict)


class _Loader(yaml.SafeLoader):
    """PyYAML's safe loader, but each key is a text, and one given twice is an error."""

    def construct_mapping(self, node: yaml.MappingNode, deep: bool = False) -> dict[Any, Any]:
        keys = [key for key, _ in node.value if isinstance(key, yaml.ScalarNode)]
        counts = Counter(key.value for key in keys)
        for key in reversed(keys):
            if counts[key.value] > 1:
                problem = f"'{key.value}' is given twice"
                raise yaml.MarkedYAMLError(problem=problem, problem_mark=key.start_mark)
            if key.value != "<<":  # which merges
                key.tag = self.DEFAULT_SCALAR_TAG  # of a text, not of yes, null or 1
        return dict(super().construct_mapping(node, deep))


def _whole(loader: yaml.SafeLoader, node: yaml.ScalarNode) -> Any:
    """Return an integer; what YAML 1.1 takes for sixtieths, as 1:9:3, stays a text."""
    return node.value if ":" in node.value else loader.construct_yaml_int(node)


_Loader.add_constructor("tag:yaml.org,2002:int", _whole)


def _letters(node: yaml.Node, known: dict[int, float]) -> float:
    """Return the letters and entries of a node whose aliases are filled in; `known` by identity."""
    if id(node) not in known:
        known[id(node)] = math.inf  # of a node within itself
        within = node.value
        if isinstance(node, yaml.MappingNode):
            within = [each for pair in node.value for each in pair]
        own = len(within) if isinstance(within, str) else sum(_letters(n, known) for n in within)
        known[id(node)] = 1 + own
    return known[id(node)]


def read_yaml(path: Path, model: type[Document]) -> Document:
    """Return the content of a YAML file as a model whose field `folder` is the file's own.

    A file that is no YAML is a `ConfigurationError`, and so are entries that are unknown, missing
    or out of range, all of them with their lines.
    """
    try:
        loader = _Loader(read_regular(path, MOST_LETTERS).decode("utf-8-sig"))
        document = loader.get_single_node()
        if document and _letters(document, {}) > MOST_LETTERS:
            raise ValueError("its aliases repeat too much, or hold themselves")
        entries = document and loader.construct_document(document)
    except OSError as error:
        fault = path_fault(path) or f"{error.strerror}; check the path"
        raise ConfigurationError(f"{path}: {fault}") from None
    except Exception as error:  # PyYAML also raises what Python says of an impossible date
        mark = getattr(error, "problem_mark", None)
        place = f", line {mark.line + 1}" if mark else ""
        problem = str(getattr(error, "problem", None) or error).splitlines()[0]
        if isinstance(error, RecursionError):
            problem = "its entries are nested too deeply"
        raise ConfigurationError(f"{path}{place}: {problem}; fix the YAML") from None
    if not isinstance(entries, dict) or "folder" in entries:
        raise ConfigurationError(f"{path}: is no mapping of entries as the example is")
    try:
        return model.model_validate({**entries, "folder": path.parent.resolve()})
    except ValidationError as error:
        messages = [_located(document, each) + each["msg"] for each in error.errors()]
        text = "; ".join(dict.fromkeys(messages)).replace("Value error, ", "")
        raise ConfigurationError(
            f"{path}: {text.replace('Field required', 'is missing')}"
        ) from None


def _located(node: yaml.Node | None, mistake: Any) -> str:
    """Return the line and the name of the entry that pydantic reports, as the document has it."""
    line, name = 1, ""
    for part in mistake["loc"]:
        pairs: list[tuple[Any, Any]] = []
        if isinstance(node, yaml.MappingNode):
            pairs = [pair for pair in node.value if pair[0].value == part]
        elif isinstance(node, yaml.SequenceNode):
            pairs = [(each, each) for k, each in enumerate(node.value) if k == part]
        if pairs:
            line, node = pairs[0][0].start_mark.line + 1, pairs[0][1]
        elif part != mistake["loc"][-1] or mistake["type"] != "missing":
            continue  # a kind, which pydantic names too
        name += f"[{part}]" if isinstance(part, int) else f".{part}"
    return f"line {line}, {name.lstrip('.')}: " if name else ""
