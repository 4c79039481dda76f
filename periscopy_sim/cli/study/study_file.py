"""A study file: the options of a command as YAML, where they are too long for a line."""

from functools import partial
from pathlib import Path
from typing import Annotated, Any

import typer

from periscopy_sim.cli.options import SCENE, example_of, option
from periscopy_sim.errors import ConfigurationError

OWN = "study", "example", "quiet", "as_json"
"""Options that a study file cannot have."""

EXAMPLE = Path(__file__).with_name("example.yaml")


def _read(context: typer.Context, file: Path | None) -> Path | None:
    """Take a study file's entries for the defaults of a command's options.

    Its entries are named as the options, and their texts are those of the command line: a list has
    what stands between commas, a mapping what is repeated as ``NAME=VALUE``.
    """
    if file is None:
        return None
    from pydantic import Field, create_model

    from periscopy_sim.storage.formats.yaml_document import Strict, read_yaml

    options = [each for each in context.command.params if each.name not in OWN]
    fields: dict[str, Any] = {
        str(each.name): (Any, Field(None, alias=str(each.name).replace("_", "-")))
        for each in options
    }
    model = create_model("Study", __base__=Strict, folder=(Path, ...), **fields)
    study = read_yaml(file, model, as_texts=True)
    given = study.model_dump(include=study.model_fields_set - {"folder"})
    context.default_map = {}
    for each in (each for each in options if each.name in given):
        value = given[each.name]
        parts = value if isinstance(value, dict) else {}
        whole = {each.name: value, **{f"{each.name}: {name}": part for name, part in parts.items()}}
        if empty := [name for name, part in whole.items() if part in (None, "", [], {})]:
            raise ConfigurationError(f"{file}: {empty[0]}: give a value, or leave the entry out")
        if parts and not each.multiple:
            raise ConfigurationError(f"{file}: {each.name}: give a value, or a list")
        context.default_map[each.name] = _entries(value) if each.multiple else _words(value)
        if isinstance(value, dict):
            each.callback = partial(_joined, context.default_map[each.name])
    return file


def _joined(study: list[str], _context: Any, _option: Any, given: list[str]) -> list[str]:
    """Return what the command line gives as ``NAME=VALUE``, and of other names what a study has."""
    if not all("=" in entry for entry in given):
        return given
    names = {entry.partition("=")[0] for entry in given}
    return [*(entry for entry in study if entry.partition("=")[0] not in names), *given]


def _entries(value: Any) -> list[str]:
    """Return what an option that is repeated is given."""
    if isinstance(value, dict):
        return [f"{name}={_words(each)}" for name, each in value.items()]
    return [_words(each) for each in (value if isinstance(value, list) else [value])]


def _words(value: Any) -> str:
    """Return what an option is given once."""
    return ",".join(map(str, value if isinstance(value, list) else [value]))


_STUDY = "YAML with these, SCENE and --out too; the command line's count first."
StudyOption = Annotated[
    Path | None, option("FILE", _STUDY, group=SCENE, is_eager=True, callback=_read)
]
ExampleOption = Annotated[bool, example_of(__name__, "a commented study file")]
