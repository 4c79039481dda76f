"""The `periscopy` command.

Exit codes: 0, or 2 with one clear line for what a user can mend.
"""

from __future__ import annotations

import os
import sys
import warnings
from typing import Any

import typer

from periscopy_sim.cli import analyze, demo, doctor, photograph, reconstruct, transport
from periscopy_sim.cli.arguments import warn
from periscopy_sim.errors import PeriscopyError

app = typer.Typer(
    help="Computational periscopy: from a photograph of a wall to the image around the corner.",
    no_args_is_help=True,
    add_completion=False,
    rich_markup_mode=None,
    pretty_exceptions_enable=False,
)
app.command("demo")(demo.demo)
app.command("doctor")(doctor.doctor)
app.command("transport")(transport.transport)
app.command("photograph")(photograph.photograph)
app.command("reconstruct")(reconstruct.reconstruct)
app.command("analyze")(analyze.analyze)


def main() -> None:
    """Run the command line; turn what a user can mend into one line and exit code 2."""
    warnings.showwarning = _one_line_warning
    try:
        code = app(standalone_mode=False)
    except PeriscopyError as error:
        _fail(str(error), 2)
    except KeyboardInterrupt:
        _fail("interrupted; nothing was written", 130)
    except typer.Abort:
        _fail("interrupted; nothing was written", 130)
    except BrokenPipeError:
        # The reader of our output left; Python would complain once more when it flushes.
        os.dup2(os.open(os.devnull, os.O_WRONLY), sys.stdout.fileno())
        raise SystemExit(1) from None
    except Exception as error:
        # What the option parser refuses: an unknown option, a missing argument.
        message = getattr(error, "format_message", None)
        if message is None:
            raise
        _fail(message(), 2)
    raise SystemExit(code if isinstance(code, int) else 0)


def _fail(message: str, code: int) -> None:
    line = " ".join(message.split())
    print(f"periscopy: error: {line}", file=sys.stderr)
    raise SystemExit(code)


def _one_line_warning(message: Warning | str, *_: Any, **__: Any) -> None:
    warn(" ".join(str(message).split()))
