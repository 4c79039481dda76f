"""What all commands have: their help, the options of their groups, ``--quiet`` and ``--json``."""

import inspect
import re
from collections.abc import Callable
from pathlib import Path
from typing import Annotated, Any, get_args

import typer
from typer.core import TyperCommand, TyperGroup

from periscopy_sim.cli.options import GROUPS, OptionGroup
from periscopy_sim.cli.output import outcome_of
from periscopy_sim.errors import PeriscopyError

HELP = {"help_option_names": ["-h", "--help"]}
"""Settings of every command's context."""


class _WithoutTypes:
    """A command, or a group, whose help gives no type to arguments and to flags."""

    def get_params(self, ctx: Any) -> Any:
        """Return the command's arguments and options, that of its help last."""
        parameters = super().get_params(ctx)  # type: ignore[misc]
        for each in parameters:
            if each.param_type_name == "argument":
                each.display_type_rich = lambda ctx: ""  # noqa: ARG005
            elif getattr(each, "is_flag", False):
                each.metavar = ""
        return parameters


class Command(_WithoutTypes, TyperCommand):
    """A command; its errors name its options as users write them."""

    def invoke(self, ctx: Any) -> Any:
        """Run the command; the library's "sbr 1e9: ..." becomes "--sbr 1e9: ..."."""
        try:
            return super().invoke(ctx)
        except PeriscopyError as error:
            names = {each.name: each.opts[0] for each in self.params if each.opts[0][:2] == "--"}
            name, *rest = re.split(r"(?=[ :])", str(error), maxsplit=1)
            is_file = Path(name).exists()  # which the error may be about
            if name not in names or is_file or not re.match(r"( [^\s']+)?: ", "".join(rest)):
                raise
            raise type(error)("".join([names[name], *rest])) from error


class CommandGroup(_WithoutTypes, TyperGroup):
    """A group of commands."""


def _for_all(
    quiet: Annotated[
        bool, typer.Option("--quiet", "-q", help="Print warnings and errors alone.")
    ] = False,
    as_json: Annotated[
        bool, typer.Option("--json", help="Print all numbers, files and warnings as JSON.")
    ] = False,
) -> None:
    """Have the options of all commands."""


def with_options_of_groups(command: Callable[..., None]) -> Callable[..., None]:
    """Return a command that takes the options of its groups one by one, and those of all."""
    parameters: list[inspect.Parameter] = []
    groups: dict[str, tuple[type[OptionGroup], list[str]]] = {}
    for name, parameter in inspect.signature(command, eval_str=True).parameters.items():
        group, *others = get_args(parameter.annotation) or (parameter.annotation,)
        members = [parameter]
        if isinstance(group, type) and issubclass(group, OptionGroup):
            members = group.parameters(*others or ({},))
            groups[name] = group, [each.name for each in members]
        parameters += members

    def run(*, quiet: bool = False, as_json: bool = False, **values: Any) -> None:
        with outcome_of(quiet, as_json):
            for name, (group, members) in groups.items():
                values[name] = group(**{each: values.pop(each) for each in members})
            command(**values)

    def place(parameter: inspect.Parameter) -> int:
        *_, described = (None, *get_args(parameter.annotation))
        return GROUPS.index(getattr(described, "rich_help_panel", None))

    parameters += inspect.signature(_for_all).parameters.values()
    keywords = [each.replace(kind=inspect.Parameter.KEYWORD_ONLY) for each in parameters]
    described: Any = run
    described.__doc__ = re.sub(r"(?<!\n)\n(?!\n)", " ", inspect.cleandoc(command.__doc__ or ""))
    described.__signature__ = inspect.Signature(sorted(keywords, key=place))
    return run
