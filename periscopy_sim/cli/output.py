"""What the commands print: lines, tables, warnings, progress, forecasts, files, verdicts, JSON."""

import json
import math
import shlex
import sys
import time
import traceback
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from contextlib import ExitStack, contextmanager
from dataclasses import dataclass, field, replace
from datetime import timedelta
from pathlib import Path
from tempfile import gettempdir
from typing import Any, NoReturn, TextIO

from rich.box import ROUNDED
from rich.console import Console
from rich.markup import escape
from rich.progress import Progress, TimeElapsedColumn
from rich.table import Column, Table
from rich.text import Text

from periscopy_sim.errors import PeriscopyError, printable
from periscopy_sim.numerics.validation import InputError
from periscopy_sim.storage.outputs import spare_inputs, staged_file, staged_folder


@contextmanager
def fixable(what: str) -> Iterator[None]:
    """Turn an InputError about the user's data into a PeriscopyError that names `what`."""
    try:
        yield
    except InputError as error:
        raise PeriscopyError(f"{what}: {error}") from error


@dataclass
class Outcome:
    """What a command has done, for its last lines or for ``--json``."""

    quiet: bool = False
    as_json: bool = False
    numbers: dict[str, Any] = field(default_factory=dict)
    files: list[Path] = field(default_factory=list)
    verdicts: list[tuple[str, str]] = field(default_factory=list)  # each with its colour
    warnings: list[str] = field(default_factory=list)

    def show(self) -> None:
        """Print the files and then the verdicts, coloured on a terminal; or all as JSON."""
        if self.as_json:
            lines = [line for line, _ in self.verdicts]
            verdict = {"verdict": "; ".join(lines)} if lines else {}
            warnings = [*dict.fromkeys([*self.numbers.get("warnings", ()), *self.warnings])]
            files = {"files": [*map(str, self.files)], "warnings": warnings}
            _put(json_of({**verdict, **self.numbers, **files}), sys.stdout)
            return
        if self.files:
            say(f"wrote {', '.join(map(str, dict.fromkeys(self.files)))}")
        for line, colour in self.verdicts:
            if not self.quiet:
                Console(highlight=False).print(Text(printable(line), colour), soft_wrap=True)
            elif colour == "red":
                warn(line)


_OUTCOMES: list[Outcome] = []
"""Of the command at work, and behind it that of its part at work; for all threads."""


def outcome() -> Outcome:
    """Return the outcome of the command at work."""
    return _OUTCOMES[-1] if _OUTCOMES else Outcome()


@contextmanager
def outcome_of(quiet: bool, as_json: bool) -> Iterator[Outcome]:
    """Collect the outcome of a command, and show it at the end; after an error only the files."""
    _OUTCOMES.append(Outcome(quiet, as_json))
    try:
        yield outcome()
    except BaseException:
        replace(outcome(), as_json=False, verdicts=[]).show()
        raise
    else:
        outcome().show()
    finally:
        _OUTCOMES.pop()


def say(message: str, *, is_result: bool = False) -> None:
    """Print one line, or several, beside JSON to standard error; if quiet, a result alone."""
    is_silent = outcome().quiet and not is_result
    for line in [] if is_silent else message.split("\n"):
        if outcome().as_json:
            _complain(line)
        else:
            _put(printable(line), sys.stdout)


def show_table(rows: Iterable[Sequence[str]], columns: Sequence[str] = ()) -> None:
    """Print rows: on a terminal as a table, else in aligned columns."""
    rows = [*rows]
    if not rows or outcome().quiet or outcome().as_json:
        return
    console = Console(highlight=False)
    if console.is_terminal:
        form: dict[str, Any] = {"box": ROUNDED}
    else:
        console = Console(highlight=False, width=WIDEST)
        form = {"box": None, "pad_edge": False, "padding": (0, 2, 0, 0)}
    headers = (Column(Text(printable(name))) for name in columns)
    table = Table(*headers, show_header=bool(columns), **form)
    for row in rows:
        table.add_row(*(Text(printable(cell)) for cell in row))
    with console.capture() as capture:
        console.print(table)
    _put("\n".join(map(str.rstrip, capture.get().splitlines())), sys.stdout)


def record(**numbers: Any) -> None:
    """Keep numbers for ``--json``; `write_json` keeps those of its file."""
    outcome().numbers.update(numbers)


def written(*paths: Path) -> None:
    """Keep the paths of written files, which the command prints before its verdict."""
    outcome().files.extend(paths)


def conclude(line: str, colour: str = "") -> None:
    """Keep a verdict, the command's last line, and its colour on a terminal."""
    outcome().verdicts.append((line, colour))


def warn(message: str, kind: str = "warning") -> None:
    """Print one line of a warning, or of an error, to standard error."""
    if kind == "warning":
        outcome().warnings.append(message)
    _complain(f"{kind}: {message}")


def _complain(line: str) -> None:
    _put(printable(f"periscopy: {line}"), sys.stderr)


def _put(text: str, stream: TextIO) -> None:
    """Print lines at once: `print` lets another thread's line between them and their end."""
    stream.write(f"{text}\n")
    stream.flush()


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


_INTERRUPTS: list[int] = []
"""The signals that `interrupt` received."""


def interrupt(number: int, _frame: object) -> NoReturn:
    """Handle Ctrl-C; `progress` raises again where a library ignored the exception."""
    _INTERRUPTS.append(number)
    raise KeyboardInterrupt


@contextmanager
def output_files(*outputs: Path, inputs: Iterable[Path | None] = ()) -> Iterator[list[Path]]:
    """Yield staged files; an OutputError if one would replace an input."""
    spare_inputs(outputs, inputs)
    with ExitStack() as stack:
        yield [stack.enter_context(staged_file(file)) for file in outputs]
    written(*outputs)


@contextmanager
def output_folder(out: Path, optional: Iterable[str] = ()) -> Iterator[Path]:
    """Yield a staged folder, whose entries count as written when all are complete.

    Files of the `optional` patterns that this run did not write are removed: they belong to a
    former run.
    """
    with staged_folder(out) as folder:
        yield folder
        entries = {entry.relative_to(folder) for entry in folder.rglob("*")}
    for file in (file for pattern in optional for file in out.glob(pattern)):
        if file.relative_to(out) not in entries:
            file.unlink()
    written(*(out / path for path in sorted(entries) if len(path.parts) == 1))


_AT_WORK: list[str] = []
"""Labels of the computations at work, of which `progress` shows the outermost."""

WIDEST = 100_000
"""Columns of a table without a terminal, whose lines must stay whole."""

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
    console, is_hidden = Console(stderr=True), bool(_AT_WORK) or outcome().quiet
    latest = clock()
    if not (is_hidden or console.is_terminal):
        _complain(label)

    def update(done: float, total: float = 1.0) -> None:
        nonlocal latest
        if _INTERRUPTS:
            raise KeyboardInterrupt
        text = f"{label}: {done} of {total} {unit}" if unit else label
        bar.update(task, description=escape(printable(text)), completed=done, total=total or 1)
        is_due = clock() - latest >= SILENCE and not outcome().quiet
        if is_due and not console.is_terminal:
            latest, state = clock(), bar.tasks[task]
            seconds = state.time_remaining  # without what a former run did
            text += f": {state.percentage:.0f} %"
            text += "" if seconds is None else f", {timedelta(seconds=seconds)} left"
            _complain(text)

    columns = *Progress.get_default_columns(), TimeElapsedColumn()
    _AT_WORK.append(label)
    try:
        with Progress(
            *columns, console=console, transient=True, disable=is_hidden or not console.is_terminal,
            get_time=clock, speed_estimate_period=math.inf,
        ) as bar:  # fmt: skip
            task = bar.add_task(escape(printable(label)), total=None)
            yield update
    finally:
        _AT_WORK.pop()


def json_of(values: Mapping[str, Any]) -> str:
    """Return values as readable JSON, arrays as lists; a ValueError if one is not finite."""

    def plain(value: Any) -> Any:
        return value.tolist() if hasattr(value, "tolist") else str(value)

    return json.dumps(values, indent=2, default=plain, allow_nan=False)


def write_json(path: Path, values: Mapping[str, Any]) -> None:
    """Write values as `json_of`, and keep them for ``--json``."""
    path.write_text(json_of(values) + "\n", "utf-8")
    record(**values)


PLURALS = {"matrix": "matrices", "geometry": "geometries"}
"""Nouns whose plural has more than an s."""


def counted(count: int, noun: str) -> str:
    """Return a count with its noun."""
    plural = PLURALS.get(noun, f"{noun}s")
    return f"{count:,} {noun if count == 1 else plural}"


def show_parts(**numbers: int) -> None:
    """Print how many photographs, ambient lights and so on a command makes."""
    record(to_make=numbers)
    words = [counted(n, noun.replace("_", " ")) for noun, n in numbers.items() if n]
    if words:
        say(f"to make: {', '.join(words)}")


def show_time(seconds: float, *apart: str) -> None:
    """Print how long a command takes, but for what is apart."""
    record(estimated_seconds=round(seconds))
    units = {"hours": 3600, "minutes": 60, "s": 1}
    unit = next((name for name, size in units.items() if seconds > 1.5 * size), "s")
    number = max(float(f"{seconds / units[unit]:.2g}"), 1.0)
    say(" and ".join([f"about {number:g} {unit}", *apart]))
