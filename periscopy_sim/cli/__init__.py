"""The `periscopy` command.

Exit codes: 0; 2 with one clear line for what a user can fix; 130 after Ctrl-C.
"""

from __future__ import annotations

import _thread
import io
import os
import signal
import sys
import threading
import warnings
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from functools import partial
from typing import Annotated, Any, NoReturn

import typer

from periscopy_sim.cli import (
    ambient,
    analyze,
    dataset,
    demo,
    design,
    doctor,
    photograph,
    reconstruct,
    sweep,
    transport,
    video,
)
from periscopy_sim.cli.calibration import calibrate
from periscopy_sim.cli.laboratory import draw, lab, prepare, tutorial, view
from periscopy_sim.cli.output import INTERRUPTED, fail, warn
from periscopy_sim.errors import PeriscopyError
from periscopy_sim.extras import EXTRA_OF, missing
from periscopy_sim.storage.outputs.staging import OUT_OF_SPACE

app = typer.Typer(
    help="Computational periscopy: from a photograph of a wall to the image around the corner.",
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


app.command("demo")(demo.demo)
app.command("doctor")(doctor.doctor)
app.command("tutorial")(tutorial.tutorial)
app.command("transport")(transport.transport)
app.command("draw")(draw.draw)
app.command("lab")(lab.lab)
app.command("view")(view.view)
app.command("photograph")(photograph.photograph)
app.command("prepare")(prepare.prepare)
app.command("ambient")(ambient.ambient)
app.command("reconstruct")(reconstruct.reconstruct)
app.command("analyze")(analyze.analyze)
app.command("design")(design.design)
app.command("calibrate")(calibrate.calibrate)
app.command("sweep")(sweep.sweep)
app.command("video")(video.video)
app.add_typer(dataset.app, name="dataset")


def main() -> None:
    """Run the command line; turn what a user can fix into one line and exit code 2."""
    warnings.showwarning = _one_line_warning
    if isinstance(sys.stdout, io.TextIOWrapper):  # it may be unable to encode a file's name
        sys.stdout.reconfigure(errors="backslashreplace")
    signal.signal(signal.SIGTERM, _interrupt)  # as batch queues send it
    sys.unraisablehook = partial(_keep_interrupts, sys.unraisablehook)
    try:
        arguments = sys.argv[1:] or ["--help"]
        with _interrupts_kept():
            code = app(arguments, prog_name="periscopy", standalone_mode=False)
        sys.stdout.flush()
    except PeriscopyError as error:
        fail(str(error), 2)
    except ModuleNotFoundError as error:
        if error.name not in EXTRA_OF:
            raise
        fail(missing(error.name), 2)
    except MemoryError as error:
        fail(f"not enough memory: {error}; take fewer pixels or patches", 2)
    except (KeyboardInterrupt, typer.Abort):
        code = INTERRUPTED
    except OSError as error:
        if error.errno not in OUT_OF_SPACE:
            raise
        sys.stdout = open(os.devnull, "w", encoding="utf-8")  # noqa: PTH123, SIM115  Python flushes it at its end
        fail(f"cannot print: {error.strerror}; free some space", 2)
    except Exception as error:
        # What the option parser refuses: an unknown option, a missing argument.
        message = getattr(error, "format_message", None)
        if message is None:
            raise
        context, asked = getattr(error, "ctx", None), getattr(error, "param", None)
        form = getattr(asked, "metavar", None) if type(error).__name__ == "MissingParameter" else ""
        hint = f" Its form: {form}." if form else ""
        hint += f" Try '{context.command_path} --help'." if context else ""
        fail(message() + hint, 2)
    if code == INTERRUPTED:
        fail("interrupted; nothing was written", INTERRUPTED)
    raise SystemExit(code if isinstance(code, int) else 0)


def _interrupt(*_: Any) -> NoReturn:
    raise KeyboardInterrupt


@contextmanager
def _interrupts_kept() -> Iterator[None]:
    """Interrupt where another error was made of it, as of one while Dr.Jit is being imported."""
    try:
        yield
    except Exception as error:
        causes: list[BaseException] = []
        cause: BaseException | None = error
        while cause is not None and cause not in causes:
            causes.append(cause)
            cause = cause.__cause__ or cause.__context__
        if any(isinstance(cause, KeyboardInterrupt) for cause in causes):
            raise KeyboardInterrupt from error
        raise


def _keep_interrupts(otherwise: Callable[[Any], object], lost: sys.UnraisableHookArgs) -> None:
    """Interrupt again where a callback from compiled code, such as numba's compiler, ignored it."""
    if issubclass(lost.exc_type, KeyboardInterrupt):
        threading.Timer(0.2, _interrupt_again).start()
    else:
        otherwise(lost)


def _interrupt_again() -> None:
    """Send this process what Ctrl-C sends."""
    if sys.platform == "win32":  # there `os.kill` would end it at once
        _thread.interrupt_main()
    else:
        os.kill(os.getpid(), signal.SIGINT)


def _one_line_warning(message: Warning | str, *_: Any, **__: Any) -> None:
    warn(" ".join(str(message).split()))
