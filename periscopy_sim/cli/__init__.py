"""The `periscopy` command.

Exit codes: 0; 1 with one line and a file for a defect; 2 with one line for an error that a user
can fix; 130 after Ctrl-C.
"""

import io
import os
import signal
import sys
import warnings
from importlib import import_module
from typing import Annotated, Any

import typer

from periscopy_sim.cli.options import HELP, RENAMED, Command, CommandGroup, with_options_of_groups
from periscopy_sim.cli.output import interrupt, warn, warn_defect
from periscopy_sim.errors import EXTRA_OF, PeriscopyError, did_you_mean, in_words, missing

INTERRUPTED = 130
"""Exit code after Ctrl-C."""

RESUMED = {"sweep", "design", "make"}
"""Last words of commands that resume in their folder what was interrupted."""

GROUPS = {
    "Start": {"demo": "start", "doctor": "start", "tutorial": "start", "fetch": "start"},
    "Laboratory": {"lab": "laboratory", "draw": "laboratory", "view": "laboratory",
                   "prepare": "laboratory", "watch": "laboratory"},
    "Recover": {"reconstruct": "reconstruct", "video": "reconstruct", "calibrate": "calibrate"},
    "Render": {"photograph": "render", "transport": "render", "ambient": "render"},
    "Study": {"sweep": "sweep", "plot": "sweep", "dataset": "dataset",
              "analyze": "design", "design": "design"},
}  # fmt: skip
"""Commands by their groups in ``--help``, with the module of each function or Typer `app`."""

MODULES = {name: module for group in GROUPS.values() for name, module in group.items()}


class _Periscopy(CommandGroup):
    """The group of all commands, each imported when it is first needed."""

    def list_commands(self, ctx: Any) -> list[str]:  # noqa: ARG002
        """Return the commands' names, in the order of `MODULES`."""
        return list(MODULES)

    def get_command(self, ctx: Any, cmd_name: str) -> Any:  # noqa: ARG002
        """Return a command's parser; None for an unknown name."""
        if cmd_name not in MODULES:
            return None
        module = import_module(f"periscopy_sim.cli.{MODULES[cmd_name]}")
        commands = getattr(module, "app", None)
        if commands is None:
            commands = typer.Typer(add_completion=False, context_settings=HELP)
            run = with_options_of_groups(getattr(module, cmd_name))
            commands.command(cmd_name, cls=Command)(run)
        command: Any = typer.main.get_command(commands)
        command.rich_help_panel = next(group for group in GROUPS if cmd_name in GROUPS[group])
        return command

    def resolve_command(self, ctx: Any, args: list[str]) -> Any:
        """Return a command; the error of an unknown name suggests the nearest one."""
        if args[0] not in MODULES and (guess := did_you_mean(args[0], MODULES)):
            ctx.fail(f"No such command '{args[0]}'; {guess}")
        return super().resolve_command(ctx, args)


app = typer.Typer(
    cls=_Periscopy,
    help="Computational periscopy: from a photograph of a wall to the image around the corner.",
    context_settings=HELP | {"token_normalize_func": lambda token: RENAMED.get(token, token)},
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
    """Run the command line; report any error on one line."""
    warnings.showwarning = lambda message, *_, **__: warn(" ".join(str(message).split()))
    if isinstance(sys.stdout, io.TextIOWrapper):  # it may be unable to encode a file's name
        sys.stdout.reconfigure(errors="backslashreplace")
    for number in (signal.SIGINT, signal.SIGTERM):  # batch queues send SIGTERM
        signal.signal(number, interrupt)
    try:
        code = app(sys.argv[1:] or ["--help"], prog_name="periscopy", standalone_mode=False)
        if code == INTERRUPTED:  # Typer makes it of a KeyboardInterrupt
            raise KeyboardInterrupt
    except (Exception, KeyboardInterrupt) as error:
        if _is_interrupt(error):
            more = "; the same command resumes" if {*sys.argv[1:3]} & RESUMED else ""
            warn(f"interrupted; no file is half-written{more}", "error")
            os._exit(INTERRUPTED)  # libraries whose threads were interrupted would complain
        if not (reason := _reason(error)):
            warn_defect(error)
            raise SystemExit(1) from None
        warn(str(PeriscopyError(reason)), "error")
        raise SystemExit(2) from None
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
    text = in_words(message()) if message else ""
    if text and context:
        stop = "" if text[-1] in ".?!" else "."
        text += f"{stop} Try '{context.command_path} --help'."
    return text


def _is_interrupt(error: BaseException | None) -> bool:
    """Return whether Ctrl-C caused an error, as during the import of a compiled library."""
    if isinstance(error, KeyboardInterrupt | typer.Abort):
        return True
    return error is not None and _is_interrupt(error.__cause__ or error.__context__)
