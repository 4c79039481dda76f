"""`periscopy dataset`: make a data set, check it, look at it."""

from __future__ import annotations

import re
import signal
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Annotated, Any

import typer
from typer.core import TyperGroup

from periscopy_sim.cli.options import OUTPUT, GroupedCommand, Out, option
from periscopy_sim.cli.output import counted_progress, progress, say, to_be_continued, warn
from periscopy_sim.errors import DatasetError, OutputError, PeriscopyError
from periscopy_sim.extras import require_all

Archive = Annotated[
    Path, typer.Argument(metavar="DATA", help="A data set, as 'periscopy dataset' writes it.")
]


class _MakesByDefault(TyperGroup):
    """Takes what names no command of the group for the arguments of `make`."""

    def parse_args(self, ctx: Any, args: list[str]) -> list[str]:
        if args and args[0] not in self.commands and args[0] != "--help":
            args = ["make", *args]
        return super().parse_args(ctx, args)


app = typer.Typer(
    cls=_MakesByDefault,
    help="Make, check and export a data set of photographs.\n\n"
    "One archive holds them with their hidden images.",
    no_args_is_help=True,
    rich_markup_mode=None,
    pretty_exceptions_enable=False,
)


@app.command("make", cls=GroupedCommand)
def make(
    configuration: Annotated[
        Path | None, typer.Argument(metavar="CONFIG.yaml", help="What it shall hold.")
    ] = None,
    out: Annotated[
        Path | None,
        option(
            "FOLDER", "The archive, a Zarr folder; goes on with one that is begun.", group=OUTPUT
        ),
    ] = None,
    count: Annotated[
        int | None, option("NUMBER", "Samples, instead of the configuration's.", min=1, max=10**8)
    ] = None,
    scheduler: Annotated[
        str | None, option("ADDRESS", "A Dask scheduler; without it, this machine.")
    ] = None,
    example: Annotated[
        bool, typer.Option("--example", help="Print a commented configuration and exit.")
    ] = False,
) -> None:
    """Make what is missing of a data set ('make' may be left out)."""
    from periscopy_sim.dataset.configuration import EXAMPLE, load_configuration
    from periscopy_sim.dataset.make import make_dataset

    if example:
        print(EXAMPLE.read_text("utf-8"), end="")
        return
    if configuration is None or out is None:
        raise PeriscopyError(
            "name a configuration and --out; 'periscopy dataset --example' prints a configuration"
        )
    require_all()
    settings = load_configuration(configuration)
    start = time.perf_counter()
    with (
        to_be_continued(),
        counted_progress("making samples", "samples") as show_blocks,
        _between_blocks() as check,
    ):

        def block_done(done: int, total: int) -> None:
            show_blocks(done, total)
            check()

        @contextmanager
        def rendering(name: str) -> Iterator[Callable[[float], None]]:
            with progress(name, lines=False) as show:

                def fraction_done(fraction: float) -> None:
                    show(fraction)
                    check()

                yield fraction_done

        made = make_dataset(
            settings, out, count=count, scheduler=scheduler, progress=block_done,
            rendering=rendering,
        )  # fmt: skip
    seconds = time.perf_counter() - start
    if made.empty_splits:
        warn(
            f"no geometry is for {' or '.join(made.empty_splits)}: give more of them, by more "
            "samples or a smaller samples_per_geometry"
        )
    if not made.made:
        say(f"{out} is complete: {made.count} samples")
        return
    say(
        f"wrote {out}: {made.made} samples of {made.geometries} geometries in {seconds:.1f} s, "
        f"{made.made / seconds:.1f} a second; {made.count} in all"
    )


@app.command("info", cls=GroupedCommand)
def info(
    data: Archive,
    as_json: Annotated[bool, typer.Option("--json", help="Print all of it as JSON.")] = False,
) -> None:
    """Print how large a data set is, and what it holds."""
    import json

    from periscopy_sim.dataset.reading import describe

    description = describe(data)
    if as_json:
        print(json.dumps(description, indent=2))
        return
    for name, value in description.items():
        say(f"{name.replace('_', ' '):13} {_in_words(name, value)}")


@app.command("verify", cls=GroupedCommand)
def verify(data: Archive) -> None:
    """Compare every file with its checksum; exit 2 if one is damaged."""
    from periscopy_sim.dataset.reading import verify_dataset

    with counted_progress("verifying", "blocks") as report:
        damaged = verify_dataset(data, report)
    for first, after in damaged:
        say(f"samples {first} to {after - 1} are missing or damaged")
    if damaged:
        raise DatasetError(
            f"{data}: is damaged; run 'periscopy dataset' with its configuration again"
        )
    say(f"{data}: all samples are whole")


@app.command("export", cls=GroupedCommand)
def export(
    data: Archive,
    out: Out,
    samples: Annotated[
        str,
        option("NUMBERS", "Which: 0,5,7 or ranges such as 0-11, by comma."),
    ] = "0-11",
) -> None:
    """Write samples as EXR and PNG files, with a contact sheet."""
    from periscopy_sim.dataset.export import export_samples
    from periscopy_sim.dataset.reading import open_dataset
    from periscopy_sim.storage.outputs.staging import staged_folder

    count = open_dataset(data, incomplete=True).sizes["sample"]
    if data.resolve() in (out.resolve(), *out.resolve().parents):
        raise OutputError(f"{out} lies within the data set; name another folder")
    with staged_folder(out) as folder, counted_progress("exporting", "samples") as report:
        written = export_samples(data, folder, parse_indices(samples, count), report)
    say(f"wrote {out}: {len(written)} files, and among them sheet.png")


def parse_indices(text: str, count: int) -> list[int]:
    """Read numbers and ranges such as ``0,4-7``; a range ends at `count` at the latest."""
    indices: list[int] = []
    for part in text.split(","):
        numbers = re.fullmatch("([0-9]{1,12})(?:-([0-9]{1,12}))?", part.strip())
        if not numbers:
            raise PeriscopyError(f"'{text}' are no samples; write 0,5,7 or a range such as 0-11")
        first, last = int(numbers[1]), int(numbers[2] or numbers[1])
        indices += range(first, min(last, count - 1) + 1) if numbers[2] else [first]
    if not indices:
        raise PeriscopyError(f"'{text}' holds no sample; the data set has {count}")
    return list(dict.fromkeys(indices))


def _in_words(name: str, value: Any) -> str:
    if name == "bytes":
        return f"{value / 1e6:.1f} MB"
    if isinstance(value, dict):
        return ", ".join(f"{key} {number}" for key, number in value.items())
    if name in ("photograph", "hidden"):
        return "x".join(map(str, value))
    if isinstance(value, list):
        return " to ".join(f"{number:.4g}" for number in value)
    return str(value)


@contextmanager
def _between_blocks() -> Iterator[Callable[[], None]]:
    """Keep Ctrl-C for where the work can stop; a second one stops it anywhere.

    Interrupted anywhere, Dr.Jit and Zarr's threads complain at length. The function that is yielded
    raises KeyboardInterrupt if Ctrl-C was pressed.
    """
    pressed: list[int] = []

    def press(number: int, _: Any) -> None:
        pressed.append(number)
        if len(pressed) > 1:
            raise KeyboardInterrupt

    def check() -> None:
        if pressed:
            raise KeyboardInterrupt

    before = {number: signal.signal(number, press) for number in (signal.SIGINT, signal.SIGTERM)}
    try:
        yield check
    finally:
        for number, handler in before.items():
            signal.signal(number, handler)
