"""Lines, warnings, progress, times and JSON of the commands."""

import json
import math
import shlex
import sys
import time
import traceback
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from contextlib import ExitStack, contextmanager
from datetime import timedelta
from pathlib import Path
from tempfile import gettempdir
from typing import Any, NoReturn

from periscopy_sim.errors import PeriscopyError, printable
from periscopy_sim.numerics.validation import InputError
from periscopy_sim.storage.outputs.staging import spare_inputs, staged_file, staged_folder


@contextmanager
def fixable(what: str) -> Iterator[None]:
    """Turn an InputError about the user's data into a PeriscopyError that names `what`."""
    try:
        yield
    except InputError as error:
        raise PeriscopyError(f"{what}: {error}") from error


def say(message: str) -> None:
    """Print one line, or several."""
    print("\n".join(map(printable, message.split("\n"))), flush=True)


def say_written(*paths: Path) -> None:
    """Print the paths of written files."""
    say(f"wrote {', '.join(map(str, paths))}")


def warn(message: str, kind: str = "warning") -> None:
    """Print one line of a warning, or of an error."""
    print(f"periscopy: {kind}: {printable(message)}", file=sys.stderr, flush=True)


def warn_defect(error: BaseException) -> None:
    """Ask for a report of an error that no user can fix; its trace goes to a temporary file."""
    trace = "\n".join([shlex.join(sys.argv), *traceback.format_exception(error)])
    path = Path(gettempdir(), f"periscopy-{time.time_ns()}.txt")
    path.write_text(trace, "utf-8", "backslashreplace")
    what = PeriscopyError(f"{type(error).__name__}: {error}")
    warn(
        f"{what}; this is a defect of periscopy: please report it, as CONTRIBUTING.md says, with "
        f"the output of 'periscopy doctor' and the trace in {path}", "error"
    )  # fmt: skip


def warn_boxed(title: str, reasons: Sequence[str], advice: str) -> None:
    """Print a boxed warning with its reasons and advice."""
    from rich.console import Console
    from rich.panel import Panel
    from rich.text import Text

    text = Text("\n".join([*(f"- {printable(reason)}" for reason in reasons), "", advice]))
    Console(stderr=True).print(Panel(text, title=title.upper()))


_INTERRUPTS: list[int] = []
"""The signals that `interrupt` received."""


def interrupt(number: int, _frame: object) -> NoReturn:
    """Handle Ctrl-C; `progress` raises again where a library ignored the exception."""
    _INTERRUPTS.append(number)
    raise KeyboardInterrupt


@contextmanager
def output_files(outputs: Sequence[Path], inputs: Iterable[Path | None]) -> Iterator[list[Path]]:
    """Yield staged files; an OutputError if one would replace an input."""
    spare_inputs(outputs, inputs)
    with ExitStack() as stack:
        yield [stack.enter_context(staged_file(file)) for file in outputs]


@contextmanager
def output_folder(out: Path, optional: Iterable[str] = ()) -> Iterator[Path]:
    """Yield a staged folder; print the path of each of its entries when all are complete.

    Files of the `optional` patterns that this run did not write are removed: they belong to a
    former run.
    """
    with staged_folder(out) as folder:
        yield folder
        written = {entry.relative_to(folder) for entry in folder.rglob("*")}
    for file in (file for pattern in optional for file in out.glob(pattern)):
        if file.relative_to(out) not in written:
            file.unlink()
    say_written(*(out / path for path in sorted(written) if len(path.parts) == 1))


_AT_WORK: list[str] = []
"""Labels of the computations at work, of which `progress` shows the outermost."""

SILENCE = 30.0
"""Seconds between lines without a terminal: a day's log stays below 3,000 lines."""


@contextmanager
def progress(
    label: str, unit: str = "", clock: Callable[[], float] = time.monotonic
) -> Iterator[Callable[..., None]]:
    """Show the progress of a long computation: a bar on a terminal, elsewhere lines now and then.

    Yield a function of the fraction done or, given a `unit`, of how many are done and of how many.
    Within the progress of another computation, there is no bar, and no line at the start.
    """
    from rich.console import Console
    from rich.markup import escape  # a label may quote names
    from rich.progress import Progress, TimeElapsedColumn

    console, is_inner = Console(stderr=True), bool(_AT_WORK)
    latest = clock()
    if not (is_inner or console.is_terminal):
        print(f"periscopy: {label}", file=sys.stderr, flush=True)

    def update(done: float, total: float = 1.0) -> None:
        nonlocal latest
        if _INTERRUPTS:
            raise KeyboardInterrupt
        text = printable(f"{label}: {done} of {total} {unit}" if unit else label)
        bar.update(task, description=escape(text), completed=done, total=total or 1)
        if not console.is_terminal and clock() - latest >= SILENCE:
            latest, state = clock(), bar.tasks[task]
            seconds = state.time_remaining  # without what a former run did
            text += f": {state.percentage:.0f} %"
            text += "" if seconds is None else f", {timedelta(seconds=seconds)} left"
            print(f"periscopy: {text}", file=sys.stderr, flush=True)

    columns = *Progress.get_default_columns(), TimeElapsedColumn()
    _AT_WORK.append(label)
    try:
        with Progress(
            *columns, console=console, transient=True, disable=is_inner or not console.is_terminal,
            get_time=clock, speed_estimate_period=math.inf,
        ) as bar:  # fmt: skip
            task = bar.add_task(escape(printable(label)), total=None)
            yield update
    finally:
        _AT_WORK.pop()


def write_json(path: Path, values: Mapping[str, Any]) -> None:
    """Write values as readable JSON, arrays as lists; a ValueError if one is not finite."""

    def plain(value: Any) -> Any:
        return value.tolist() if hasattr(value, "tolist") else str(value)

    text = json.dumps(values, indent=2, default=plain, allow_nan=False)
    path.write_text(text + "\n", "utf-8")
