"""What the commands print and write: lines, warnings, progress, times, JSON."""

from __future__ import annotations

import sys
import time
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from pathlib import Path
from typing import Any, NoReturn

from periscopy_sim.errors import PeriscopyError
from periscopy_sim.storage.outputs.staging import staged_folder

INTERRUPTED = 130
"""Exit code after Ctrl-C. Newer versions of typer return it, older ones raise Abort."""

BETWEEN_LINES = 20.0
"""Seconds between two lines of progress where there is no terminal."""


@contextmanager
def fixable(what: str, files: Iterable[str] = ()) -> Iterator[None]:
    """Report a ValueError about the user's data as the user's mistake.

    A message that begins with one of the files' names is about that file, before what it is for.
    """
    try:
        yield
    except PeriscopyError:
        raise
    except ValueError as error:
        of_file = any(str(error).startswith(f"{file}: ") for file in files)
        raise PeriscopyError(f"{error} ({what})" if of_file else f"{what}: {error}") from error


def say(message: str) -> None:
    """Print one line to the user."""
    print(message, flush=True)


def warn(message: str) -> None:
    """Print one warning line."""
    print(f"periscopy: warning: {message}", file=sys.stderr, flush=True)


def warn_boxed(title: str, reasons: Sequence[str], advice: str) -> None:
    """Print a warning that nobody overlooks, with its reasons and what to do."""
    import textwrap

    lines = [title.upper(), ""]
    for reason in reasons:
        lines += textwrap.wrap(f"- {reason}", 92, subsequent_indent="  ")
    lines += ["", *textwrap.wrap(advice, 92)]
    print("#" * 96, file=sys.stderr)
    for line in lines:
        print(f"# {line:92} #", file=sys.stderr)
    print("#" * 96, file=sys.stderr, flush=True)


def fail(message: str, code: int) -> NoReturn:
    """Print why a command failed, as one line, and end with an exit code."""
    print(f"periscopy: error: {' '.join(message.split())}", file=sys.stderr)
    raise SystemExit(code)


@contextmanager
def told_folder(out: Path) -> Iterator[Path]:
    """Fill a staged folder, and print the path of each file once all are in their place."""
    with staged_folder(out) as folder:
        yield folder
        names = sorted(entry.name for entry in folder.iterdir())
    say_written(*(out / name for name in names))


def say_written(*paths: Path) -> None:
    """Print what was written, each path from here."""
    say(f"wrote {', '.join(map(str, paths))}")


@contextmanager
def to_be_continued() -> Iterator[None]:
    """Say after Ctrl-C that the same command goes on where it stopped."""
    try:
        yield
    except KeyboardInterrupt:
        fail("interrupted; the same command goes on where it stopped", INTERRUPTED)


@contextmanager
def progress(label: str, *, lines: bool = True) -> Iterator[Callable[[float], None]]:
    """Show how far a long computation is: a bar on a terminal, a plain line now and then elsewhere.

    What is yielded takes the fraction done, 0 to 1. Without `lines` there are none elsewhere.
    """
    with _bar(label, lines=lines) as update:
        yield lambda fraction: update(fraction, f"{100 * fraction:.0f} %")


@contextmanager
def counted_progress(label: str, unit: str) -> Iterator[Callable[[int, int], None]]:
    """Show how many of many things are done; see `progress`.

    What is yielded takes how many are done, and of how many.
    """
    with _bar(label) as update:
        yield lambda done, total: update(done / max(total, 1), f"{done} of {total} {unit}")


@contextmanager
def _bar(label: str, *, lines: bool = True) -> Iterator[Callable[[float, str], None]]:
    """Yield a function that shows a fraction done, and its text."""
    from rich.console import Console
    from rich.progress import BarColumn, Progress, TextColumn, TimeRemainingColumn

    console = Console(stderr=True)
    lines &= not console.is_terminal
    last = time.monotonic()

    def say_stage(text: str) -> None:
        if lines:
            print(f"periscopy: {text}", file=sys.stderr, flush=True)

    def update(fraction: float, text: str) -> None:
        nonlocal last
        bar.update(task, total=1.0, completed=fraction, text=text)
        if time.monotonic() - last > BETWEEN_LINES:
            last = time.monotonic()
            say_stage(f"{label}: {text}")

    say_stage(label)
    columns = (
        TextColumn("{task.description}"), BarColumn(), TextColumn("{task.fields[text]}"),
        TimeRemainingColumn(),
    )  # fmt: skip
    disabled = not console.is_terminal
    with Progress(*columns, console=console, transient=True, disable=disabled) as bar:
        task = bar.add_task(label, total=None, text="")
        yield update


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
    """Return values as JSON, human-readable, with arrays as lists; a ValueError if one is NaN."""
    import json

    import numpy as np

    def plain(value: Any) -> Any:
        if isinstance(value, np.ndarray | np.generic):
            return value.tolist()
        return str(value)

    return json.dumps(values, indent=2, default=plain, allow_nan=False) + "\n"


def write_json(path: Path, values: Mapping[str, Any]) -> None:
    """Write a JSON file; see `as_json`."""
    path.write_text(as_json(values), "utf-8")
