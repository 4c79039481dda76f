"""What the commands have in common: the forms of their arguments, messages and progress."""

from __future__ import annotations

import re
import sys
import time
from collections.abc import Callable, Iterator, Mapping
from contextlib import contextmanager
from importlib.util import find_spec
from pathlib import Path
from typing import Annotated, Any

import typer

from periscopy_sim.errors import PeriscopyError

EXTRAS = {
    "xarray": "sweep",
    "zarr": "sweep",
    "distributed": "sweep",
    "cloudpickle": "sweep",
    "google_crc32c": "dataset",
}
"""Modules that the core install lacks, and the extra that brings each."""

Out = Annotated[
    Path, typer.Option("--out", help="Folder to write; appears complete or not at all.")
]
OutFile = Annotated[
    Path, typer.Option("--out", help="File to write; appears complete or not at all.")
]
SceneArgument = Annotated[
    str, typer.Argument(metavar="SCENE", help="A Mitsuba XML file, or the name of a shipped scene.")
]
SceneOption = Annotated[
    str, typer.Option("--scene", help="A Mitsuba XML file, or the name of a shipped scene.")
]
Hidden = Annotated[
    str,
    typer.Option(
        "--hidden", metavar="ROWSxCOLUMNS", help="Patches of the hidden image, such as 29x36."
    ),
]
Define = Annotated[
    list[str] | None,
    typer.Option("-D", metavar="NAME=VALUE", help="Set one of the scene's <default>s; repeatable."),
]
Samples = Annotated[int, typer.Option(min=1, help="Samples of a patch for each wall point.")]
# Mitsuba takes seeds of 32 bits; twice this still fits, for renderings in two passes.
Seed = Annotated[int, typer.Option(min=0, max=2**31 - 1, help="Seed of every random draw.")]


def _within_bounds(snr: float | None) -> float | None:
    # Not by the option's own bounds: the parsers' versions differ in what they say of NaN.
    if snr is not None and not -100 <= snr <= 300:
        raise typer.BadParameter(f"{snr:g} is not a finite number of dB from -100 to 300")
    return snr


_snr = typer.Option(
    "--snr",
    callback=_within_bounds,
    help="Gaussian noise at this signal-to-noise ratio, -100 to 300 dB.",
)
Snr = Annotated[float, _snr]
OptionalSnr = Annotated[float | None, _snr]


def parse_size(text: str) -> tuple[int, int]:
    """Read ROWSxCOLUMNS.

    Raises
    ------
    PeriscopyError
        If the text is of another form.
    """
    size = re.fullmatch(r"([0-9]{1,9})x([0-9]{1,9})", text, re.IGNORECASE)
    if not size:
        raise PeriscopyError(f"'{text}' is not a size; write ROWSxCOLUMNS, such as 29x36")
    return int(size[1]), int(size[2])


def parse_definitions(definitions: list[str] | None, option: str = "-D") -> dict[str, str]:
    """Read ``-D name=value`` options, or those of another name.

    Raises
    ------
    PeriscopyError
        If one is of another form or a name is given twice.
    """
    values: dict[str, str] = {}
    for definition in definitions or []:
        name, separator, value = definition.partition("=")
        if not (name and separator and value):
            raise PeriscopyError(f"{option} '{definition}' is not of the form name=value")
        if name in values:
            raise PeriscopyError(f"{option} {name} is given twice")
        values[name] = value
    return values


def require(*extras: str) -> None:
    """Refuse to start work that would end for want of a module of these extras.

    Raises
    ------
    PeriscopyError
        Naming the first module that is not installed.
    """
    for module, extra in EXTRAS.items():
        if extra in extras and find_spec(module) is None:
            raise PeriscopyError(missing(module))


def missing(module: str) -> str:
    """Return one line that says which extra brings a module."""
    return (
        f"this needs {module}, which is not installed; install it by: pip install "
        f"'periscopy-sim[{EXTRAS[module]}]'"
    )


@contextmanager
def mendable(what: str) -> Iterator[None]:
    """Report a ValueError about the user's data as the user's mistake."""
    try:
        yield
    except PeriscopyError:
        raise
    except ValueError as error:
        raise PeriscopyError(f"{what}: {error}") from error


def say(message: str) -> None:
    """Print one line to the user."""
    print(message, flush=True)


def warn(message: str) -> None:
    """Print one warning line."""
    print(f"periscopy: warning: {message}", file=sys.stderr, flush=True)


@contextmanager
def progress(label: str) -> Iterator[Callable[[float], None]]:
    """Show a bar on a terminal while a long computation reports the fraction done.

    Yields
    ------
    callable
        Takes the fraction done, 0 to 1.
    """
    from rich.console import Console
    from rich.progress import BarColumn, Progress, TaskProgressColumn, TextColumn
    from rich.progress import TimeRemainingColumn as Remaining

    columns = (TextColumn("{task.description}"), BarColumn(), TaskProgressColumn(), Remaining())
    console = Console(stderr=True)
    with Progress(
        *columns, console=console, transient=True, disable=not console.is_terminal
    ) as bar:
        task = bar.add_task(label, total=1.0)
        yield lambda fraction: bar.update(task, completed=fraction)


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


def write_json(path: Path, values: Mapping[str, Any]) -> None:
    """Write a JSON file, human-readable, with arrays as lists and no NaN."""
    import json

    import numpy as np

    def plain(value: Any) -> Any:
        if isinstance(value, np.ndarray | np.generic):
            return value.tolist()
        return str(value)

    path.write_text(json.dumps(values, indent=2, default=plain, allow_nan=False) + "\n")
