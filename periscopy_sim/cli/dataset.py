"""`periscopy dataset`: make a data set, check it, look at it."""

import time
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer
from rich.filesize import decimal

import periscopy_sim as ps
from periscopy_sim.cli import messages, options, output
from periscopy_sim.dataset.reading import describe, export_samples, open_dataset, verify_dataset
from periscopy_sim.errors import SWEEP, DatasetError, require_all
from periscopy_sim.storage.outputs import staged_folder
from periscopy_sim.storage.places import place

if TYPE_CHECKING:
    from periscopy_sim.dataset.make import Work

_CONFIGURATION = "The configuration; see --example."
_COUNT = "Samples, instead of the configuration's."
_SAMPLES = "Numbers and ranges, such as 0,4-7. [default: the first twelve]"
_DATA = "A data set, as 'periscopy dataset' writes it."
Archive = Annotated[Path, options.argument("DATA", _DATA, parser=str, callback=place)]
_MODULE = "periscopy_sim.dataset.configuration"
Example = Annotated[bool, options.example_of(_MODULE, "a commented configuration")]


class _MakesByDefault(options.CommandGroup):
    """A group whose default command is `make`."""

    def parse_args(self, ctx: Any, args: list[str]) -> list[str]:
        if (
            args
            and args[0] not in self.commands
            and args[0] not in options.HELP["help_option_names"]
        ):
            args = ["make", *args]
        return super().parse_args(ctx, args or ["--help"])


app = typer.Typer(
    name="dataset", cls=_MakesByDefault, add_completion=False, context_settings=options.HELP,
    help="Make, check and export a data set of photographs.", pretty_exceptions_enable=False,
)  # fmt: skip


@app.command("make", cls=options.Command)
@options.with_options_of_groups
def make(
    configuration: Annotated[Path, options.argument("CONFIG.yaml", _CONFIGURATION, exists=True)],
    out: options.Store,
    count: Annotated[int | None, options.option("NUMBER", _COUNT, kind="samples")] = None,
    scheduler: options.Scheduler = None,
    example: Example = False,  # noqa: ARG001
) -> None:
    """Make or continue a data set ('make' is optional)."""
    require_all(*SWEEP)
    settings = ps.load_configuration(configuration)
    start, lights = time.perf_counter(), list[str]()

    def planned(work: "Work") -> None:
        if work.samples:
            samples = output.counted(work.samples, "sample")
            of, size = output.counted(work.geometries, "geometry"), decimal(work.size)
            output.say(f"{samples} of {of}, {size} before compression")
            output.show_parts(matrix=work.geometries, ambient_light=work.lights)
            lights.extend([output.counted(work.lights, "ambient light")] if work.lights else [])

    with output.progress("making samples", "samples") as report:
        result = ps.make_dataset(
            settings, out, count=count, scheduler=scheduler, planned=planned,
            estimated=lambda seconds: output.show_time(seconds, *lights), progress=report,
            rendering=output.progress,
        )  # fmt: skip
    seconds = time.perf_counter() - start
    if result.empty_splits:
        output.warn(messages.sentence("empty_splits", splits=" or ".join(result.empty_splits)))
    numbers = {"made": result.made, "geometries": result.geometries, "samples": result.count}
    output.record(**numbers, seconds=seconds)
    output.written(out)
    output.conclude(
        f"{result.made} samples of {result.geometries} geometries in {seconds:.1f} s; "
        f"{result.count} samples in all"
        if result.made else f"{out} is complete: {result.count} samples", "green"
    )  # fmt: skip


@app.command("info", cls=options.Command)
@options.with_options_of_groups
def info(data: Archive) -> None:
    """Print the size and the contents of a data set."""
    description = describe(data)
    output.record(**description)
    output.show_table([name.replace("_", " "), str(value)] for name, value in description.items())


@app.command("verify", cls=options.Command)
@options.with_options_of_groups
def verify(data: Archive) -> None:
    """Compare every file with its checksum; exit 2 if one is damaged."""
    with output.progress("verifying", "blocks") as report:
        damaged = verify_dataset(data, report)
    for first, after in damaged:
        output.say(f"samples {first} to {after - 1} are missing or damaged")
    if damaged:
        raise DatasetError(
            f"{data}: is unfinished or damaged; run 'periscopy dataset CONFIG.yaml' again"
        )
    output.conclude(f"{data}: all samples are whole", "green")


@app.command("export", cls=options.Command)
@options.with_options_of_groups
def export(
    data: Archive,
    out: options.Out,
    samples: Annotated[str, options.option("NUMBERS", _SAMPLES)] = "",
) -> None:
    """Write samples as EXR files, with a contact sheet."""
    count = open_dataset(data, incomplete=True).sizes["sample"]
    with staged_folder(out) as folder, output.progress("exporting", "samples") as report:
        indices = options.parse_indices(samples or f"0-{min(count, 12) - 1}", count)
        files = export_samples(data, folder, indices, report)
    output.written(out)
    output.conclude(f"{len(files)} files, among them sheet.png")
