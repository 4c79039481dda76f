"""Lines, warnings, progress, times and JSON of the commands."""

from __future__ import annotations

import json
import sys
import textwrap
import time
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from pathlib import Path
from typing import Any, NoReturn

from periscopy_sim.errors import PeriscopyError
from periscopy_sim.storage.outputs.resume import (
    alone_in,
    check_settings,
    read_settings,
    refuse_results,
    write_settings,
)
from periscopy_sim.storage.outputs.staging import staged_folder

INTERRUPTED = 130
"""Exit code after Ctrl-C."""

BETWEEN_LINES = 20.0
"""Seconds between two lines of progress where there is no terminal."""


@contextmanager
def fixable(what: str, files: Iterable[str] = ()) -> Iterator[None]:
    """Turn a ValueError about the user's data into a PeriscopyError that names `what`.

    A message about one of the `files` begins with that file's name.
    """
    try:
        yield
    except PeriscopyError:
        raise
    except ValueError as error:
        of_file = any(str(error).startswith(f"{file}: ") for file in files)
        raise PeriscopyError(f"{error} ({what})" if of_file else f"{what}: {error}") from error


def say(message: str) -> None:
    """Print one line."""
    print(message, flush=True)


def say_written(*paths: Path) -> None:
    """Print the paths of written files."""
    say(f"wrote {', '.join(map(str, paths))}")


def warn(message: str) -> None:
    """Print one warning line."""
    print(f"periscopy: warning: {message}", file=sys.stderr, flush=True)


def warn_boxed(title: str, reasons: Sequence[str], advice: str) -> None:
    """Print a boxed warning with its reasons and advice."""
    bullets = [textwrap.fill(f"- {reason}", 92, subsequent_indent="  ") for reason in reasons]
    text = "\n".join([title.upper(), "", *bullets, "", textwrap.fill(advice, 92)])
    box = "\n".join(f"# {line:92} #" for line in text.splitlines())
    print("#" * 96, box, "#" * 96, sep="\n", file=sys.stderr, flush=True)


def fail(message: str, code: int) -> NoReturn:
    """Print an error on one line, and exit with a code."""
    print(f"periscopy: error: {PeriscopyError(message)}", file=sys.stderr, flush=True)
    raise SystemExit(code)


_INTERRUPTS: list[int] = []
"""The signals that `interrupt` received."""


def interrupt(number: int, _frame: object) -> NoReturn:
    """Handle Ctrl-C; `progress` raises again where a library ignored the exception."""
    _INTERRUPTS.append(number)
    raise KeyboardInterrupt


@contextmanager
def output_folder(out: Path, optional: Iterable[str] = ()) -> Iterator[Path]:
    """Yield a staged folder; print the path of each of its files when all are complete.

    The `optional` files that this run did not write are removed: they belong to a former run.
    """
    with staged_folder(out) as folder:
        yield folder
        names = sorted(entry.name for entry in folder.iterdir())
    for name in set(optional).difference(names):
        (out / name).unlink(missing_ok=True)
    say_written(*(out / name for name in names))


@contextmanager
def resumed_folder(
    out: Path,
    settings: Mapping[str, Any],
    what: str,
    files: Sequence[str],
    varied: Iterable[str] | None = None,
) -> Iterator[None]:
    """Fill a folder over many runs of the same settings, alone in it.

    A folder of other settings, or with `files` of unknown settings, is an OutputError. Until the
    first of its files exists, the `varied` settings may differ; all of them by default.
    """

    def check() -> None:
        held = read_settings(out)
        if held is None:
            refuse_results(out, files)
            return
        if not (out / files[0]).exists():
            held |= {name: settings[name] for name in varied or settings}
        check_settings(held, settings, str(out), what)

    check()  # before the folder is made
    with alone_in(out):
        check()
        if not (out / files[0]).exists():
            write_settings(out, settings)
        yield


_AT_WORK: list[str] = []
"""Labels of the computations at work, of which `progress` shows the outermost."""


@contextmanager
def progress(label: str, unit: str = "", *, lines: bool = True) -> Iterator[Callable[..., None]]:
    """Show the progress of a long computation: a bar on a terminal, else a line now and then.

    Yield a function of the fraction done or, given a `unit`, of how many are done and of how many.
    Within the progress of another computation, nothing is shown; without `lines`, only a bar.
    """
    from rich.console import Console
    from rich.progress import BarColumn, Progress, TextColumn, TimeRemainingColumn

    console = Console(stderr=True)
    shown, last = not _AT_WORK, time.monotonic()
    bars, lines = shown and console.is_terminal, shown and lines and not console.is_terminal

    def print_line(text: str) -> None:
        if lines:
            print(f"periscopy: {text}", file=sys.stderr, flush=True)

    def update(done: float, total: float = 1.0) -> None:
        nonlocal last
        if _INTERRUPTS:
            raise KeyboardInterrupt
        text = f"{label}: " + (f"{done} of {total} {unit}" if unit else f"{100 * done:.0f} %")
        bar.update(task, description=text, completed=done, total=total or 1)
        if time.monotonic() - last > BETWEEN_LINES:
            last = time.monotonic()
            print_line(text)

    print_line(label)
    columns = TextColumn("{task.description}"), BarColumn(), TimeRemainingColumn()
    _AT_WORK.append(label)
    try:
        with Progress(*columns, console=console, transient=True, disable=not bars) as bar:
            task = bar.add_task(label, total=None)
            yield update
    finally:
        _AT_WORK.pop()


class Stopwatch:
    """Seconds that the stages of a command took, by name."""

    def __init__(self) -> None:
        self.seconds: dict[str, float] = {}

    @contextmanager
    def __call__(self, stage: str) -> Iterator[None]:
        """Time a block."""
        start = time.perf_counter()
        yield
        self.seconds[stage] = round(time.perf_counter() - start, 4)


def as_json(values: Mapping[str, Any]) -> str:
    """Return values as readable JSON, arrays as lists; a ValueError if one is not finite."""

    def plain(value: Any) -> Any:
        return value.tolist() if hasattr(value, "tolist") else str(value)

    return json.dumps(values, indent=2, default=plain, allow_nan=False) + "\n"


def write_json(path: Path, values: Mapping[str, Any]) -> None:
    """Write a JSON file; see `as_json`."""
    path.write_text(as_json(values), "utf-8")
