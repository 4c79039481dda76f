"""The `periscopy` command.

Exit codes: 0; 2 with one line for an error that a user can fix; 130 after Ctrl-C.
"""

from __future__ import annotations

import _thread
import io
import os
import signal
import sys
import threading
import warnings
from collections.abc import Callable, Iterator, Mapping
from functools import partial
from importlib import import_module
from typing import Annotated, Any

import typer
from typer.core import TyperGroup

from periscopy_sim.cli.options import RENAMED, GroupedCommand, with_options_of_groups
from periscopy_sim.cli.output import INTERRUPTED, fail, interrupt, warn
from periscopy_sim.errors import PeriscopyError
from periscopy_sim.extras import EXTRA_OF, missing

MODULES = {
    "demo": "start.demo", "doctor": "start.doctor", "tutorial": "start.tutorial",
    "transport": "transport", "draw": "laboratory.draw", "lab": "laboratory.lab",
    "view": "laboratory.view", "photograph": "photograph", "prepare": "laboratory.prepare",
    "ambient": "ambient", "reconstruct": "reconstruct", "analyze": "analyze", "design": "design",
    "calibrate": "calibration.calibrate", "sweep": "sweep", "video": "video", "dataset": "dataset",
}  # fmt: skip
"""The module of each command: a function of its name, or the Typer `app` of a group."""


class _Commands(Mapping[str, Any]):
    """The commands' parsers by name, each imported when it is first needed."""

    def __iter__(self) -> Iterator[str]:
        return iter(MODULES)

    def __len__(self) -> int:
        return len(MODULES)

    def __getitem__(self, name: str) -> Any:
        module = import_module(f"periscopy_sim.cli.{MODULES[name]}")
        commands = getattr(module, "app", None)
        if commands is None:
            commands = typer.Typer(add_completion=False, rich_markup_mode=None)
            command = with_options_of_groups(getattr(module, name))
            commands.command(name, cls=GroupedCommand)(command)
        return typer.main.get_command(commands)


class _Periscopy(TyperGroup):
    """The group of all commands."""

    def __init__(self, **options: Any) -> None:
        super().__init__(**options)
        self.commands: Any = _Commands()


app = typer.Typer(
    cls=_Periscopy,
    help="Computational periscopy: from a photograph of a wall to the image around the corner.",
    context_settings={"token_normalize_func": lambda token: RENAMED.get(token, token)},
    rich_markup_mode=None,
    invoke_without_command=True,
    pretty_exceptions_enable=False,
)


@app.callback()
def _periscopy(
    version: Annotated[bool, typer.Option("--version", help="Show the version and exit.")] = False,
) -> None:
    if version:
        from importlib.metadata import version as version_of

        print(f"periscopy_sim {version_of('periscopy-sim')}")
        raise typer.Exit


def main() -> None:
    """Run the command line; report an error that a user can fix on one line, with exit code 2."""
    warnings.showwarning = lambda message, *_, **__: warn(" ".join(str(message).split()))
    if isinstance(sys.stdout, io.TextIOWrapper):  # it may be unable to encode a file's name
        sys.stdout.reconfigure(errors="backslashreplace")
    for number in (signal.SIGINT, signal.SIGTERM):  # batch queues send SIGTERM
        signal.signal(number, interrupt)
    sys.unraisablehook = partial(_keep_interrupts, sys.unraisablehook)
    try:
        try:
            code = app(sys.argv[1:] or ["--help"], prog_name="periscopy", standalone_mode=False)
        except (Exception, KeyboardInterrupt) as error:
            if _is_interrupt(error):
                fail("interrupted; no file is half-written", INTERRUPTED)
            if not (reason := _reason(error)):
                raise
            fail(reason, 2)
    except SystemExit as end:
        code = end.code
    if code == INTERRUPTED:
        os._exit(INTERRUPTED)  # libraries whose threads were interrupted would complain
    raise SystemExit(code if isinstance(code, int) else 0)


def _reason(error: BaseException) -> str:
    """Return the message of an error that a user can fix; empty for a defect of the package."""
    if isinstance(error, PeriscopyError):
        return str(error)
    if isinstance(error, ModuleNotFoundError) and error.name in EXTRA_OF:
        return missing(error.name)
    if isinstance(error, MemoryError):
        return f"not enough memory: {error}; take fewer pixels or patches"
    if isinstance(error, OSError) and error.strerror:
        return f"{error.filename or 'the system'}: {error.strerror}"
    # The option parser's errors: an unknown option, a missing argument.
    message = getattr(error, "format_message", None)
    context = getattr(error, "ctx", None)
    more = f" Try '{context.command_path} --help'." if context else ""
    return f"{message()}{more}" if message else ""


def _keep_interrupts(otherwise: Callable[[Any], object], lost: sys.UnraisableHookArgs) -> None:
    """Interrupt again where a callback from compiled code, such as numba's compiler, ignored it."""
    if issubclass(lost.exc_type, KeyboardInterrupt):
        threading.Timer(0.2, _thread.interrupt_main).start()
    else:
        otherwise(lost)


def _is_interrupt(error: BaseException | None) -> bool:
    """Return whether Ctrl-C caused an error, as during the import of a compiled library."""
    if isinstance(error, KeyboardInterrupt | typer.Abort):
        return True
    return error is not None and _is_interrupt(error.__cause__ or error.__context__)
