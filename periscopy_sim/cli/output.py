"""What the commands tell: lines, warnings, progress, times, files, JSON."""

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

FORETELLS = 0.02
"""Part of the work from which it tells how long the rest takes; before, kernels are compiled."""


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
    from rich.progress import BarColumn, TaskProgressColumn

    with _shown(label, BarColumn(), TaskProgressColumn(), lines=lines) as (update, told):

        def report(fraction: float) -> None:
            update(total=1.0, completed=fraction)
            told(f"{100 * fraction:.0f} %", fraction)

        yield report


@contextmanager
def counted_progress(label: str, unit: str) -> Iterator[Callable[[int, int], None]]:
    """Show how many of many things are done, and how many a second; see `progress`.

    What is yielded takes how many are done, and of how many.
    """
    from rich.progress import BarColumn, MofNCompleteColumn, TextColumn

    columns = BarColumn(), MofNCompleteColumn(), TextColumn("{task.fields[rate]}")
    begun: list[tuple[float, int]] = []
    with _shown(label, *columns) as (update, told):

        def report(done: int, total: int) -> None:
            if not begun:
                begun.append((time.perf_counter(), done))
            start, before = begun[0]
            rate = (done - before) / max(time.perf_counter() - start, 1e-9)
            text = f"{rate:.1f} {unit}/s" if done > before else ""
            update(total=total, completed=done, rate=text)
            told(f"{done} of {total} {unit}", done / max(total, 1))

        yield report


def _left(passed: float, fraction: float) -> str:
    """Return how long the rest takes if it goes on as it did, as ", about 12 s left"."""
    if not FORETELLS <= fraction < 1:
        return ""
    left = passed * (1 - fraction) / fraction
    return f", about {left:.0f} s left" if left < 100 else f", about {left / 60:.0f} min left"


@contextmanager
def _shown(
    label: str, *columns: Any, lines: bool = True
) -> Iterator[tuple[Callable[..., None], Callable[[str, float], None]]]:
    """Yield what updates a bar, and what prints a line if it is time for one."""
    from rich.console import Console
    from rich.progress import Progress, TextColumn, TimeRemainingColumn

    console = Console(stderr=True)
    watched = console.is_terminal
    begun = last = time.monotonic()

    def told(how_far: str, fraction: float) -> None:
        nonlocal last
        if lines and not watched and time.monotonic() - last > BETWEEN_LINES:
            last = time.monotonic()
            how_far += _left(last - begun, fraction)
            print(f"periscopy: {label}: {how_far}", file=sys.stderr, flush=True)

    if lines and not watched:
        print(f"periscopy: {label}", file=sys.stderr, flush=True)
    columns = (TextColumn("{task.description}"), *columns, TimeRemainingColumn())
    with Progress(*columns, console=console, transient=True, disable=not watched) as bar:
        task = bar.add_task(label, total=None, rate="")
        yield lambda **fields: bar.update(task, **fields), told


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
