"""`periscopy video`: from a sequence of photographs to the hidden video."""

from __future__ import annotations

import time
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import TYPE_CHECKING, Annotated, Any

import numpy as np
import typer

from periscopy_sim.cli import masks
from periscopy_sim.cli import scene as scenes
from periscopy_sim.cli.arguments import (
    Define,
    Hidden,
    Out,
    Samples,
    SceneOption,
    Seed,
    Stopwatch,
    mendable,
    say,
    warn,
    write_json,
)
from periscopy_sim.cli.video_input import check_left_over, decoded_photographs, decoded_truth
from periscopy_sim.cli.video_methods import (
    Coupling,
    VideoMethod,
    checked_settings,
    fitted,
    live_rate,
    solutions,
)
from periscopy_sim.cli.video_metrics import Record, compare, medians_of, record_of, write_table
from periscopy_sim.cli.video_pictures import draw_frames, draw_sheet, draw_video, white_of

if TYPE_CHECKING:
    from periscopy_sim.cli.video_methods import Solution
    from periscopy_sim.figures.panels import Image


def _not_nan(value: float | None) -> float | None:
    # The parsers' versions differ in whether NaN is within bounds.
    if value is not None and np.isnan(value):
        raise typer.BadParameter("nan is not a number")
    return value


def video(
    frames: Annotated[
        Path,
        typer.Argument(
            metavar="FRAMES",
            help="Photographs in time's order: a folder of files that reconstruct takes, a Zarr "
            "archive, a multi-part EXR, an NPY or NPZ stack (frames, rows, columns, 3).",
        ),
    ],
    scene: SceneOption,
    hidden: Hidden,
    out: Out,
    method: Annotated[
        VideoMethod, typer.Option(help="How each frame is recovered.")
    ] = VideoMethod.preconditioned,
    coupling: Annotated[
        Coupling,
        typer.Option(
            help="How each frame is tied to the one before it; total-variation is of the "
            "preconditioned method."
        ),
    ] = Coupling.l1,
    temporal_weight: Annotated[
        float | None,
        typer.Option(
            min=0,
            max=1e9,
            callback=_not_nan,
            help="Weight of differences in time within total variation; 1 if not given.",
        ),
    ] = None,
    l1_weight: Annotated[
        float | None,
        typer.Option(
            min=0,
            max=1e9,
            callback=_not_nan,
            help="Weight of the l1 difference to the frame before, over that of TV; 0.4 if not "
            "given, by noise-aware 0.8.",
        ),
    ] = None,
    samples: Samples = 16,
    model: scenes.ModelOption = scenes.Model.rendered,
    matrix: Annotated[
        Path | None,
        typer.Option("--transport", help="Take A from this NPY file rather than render it."),
    ] = None,
    tv_weight: Annotated[
        float | None,
        typer.Option(
            min=0,
            max=1e9,
            callback=_not_nan,
            help="TV weight, in standard errors of the estimate; 0: none; 1 if not given. This "
            "and the next two are of the preconditioned method.",
        ),
    ] = None,
    repair_threshold: Annotated[
        float | None,
        typer.Option(
            min=0,
            max=1e9,
            callback=_not_nan,
            help="Repair patches that differ from their neighbours by more than this part of the "
            "image's 99th percentile; 0.1 if not given.",
        ),
    ] = None,
    rank_tolerance: Annotated[
        float | None,
        typer.Option(
            min=1e-15,
            max=0.5,
            callback=_not_nan,
            help="Relative tolerance on B's singular values; 1e-10 if not given.",
        ),
    ] = None,
    truth: Annotated[
        str | None,
        typer.Option(
            help="What was hidden, if known: a folder of pictures or an NPY stack, one for each "
            "photograph, or one image (a file or a shipped one) for all; adds metrics and "
            "frames_sheet.png."
        ),
    ] = None,
    rate: Annotated[
        float,
        typer.Option(min=0.1, max=1000, callback=_not_nan, help="Animation's frames a second."),
    ] = 16.0,
    batch: Annotated[
        int,
        typer.Option(min=1, max=4096, help="Photographs that P or A is applied to in one product."),
    ] = 16,
    mask: masks.MaskOption = None,
    seed: Seed = 0,
    define: Define = None,
) -> None:
    """Recover a hidden video from a sequence of photographs of the wall."""
    from threadpoolctl import threadpool_limits

    from periscopy_sim.analytic.point_light import point_light_backgrounds
    from periscopy_sim.photographs.defects import defective_pixels
    from periscopy_sim.storage.outputs.provenance import as_text
    from periscopy_sim.storage.outputs.staging import staged_folder
    from periscopy_sim.storage.sequences.opening import open_frames

    weights, settings = checked_settings(
        method,
        coupling,
        {"temporal_weight": temporal_weight, "l1_weight": l1_weight},
        tv_weight=tv_weight,
        repair_threshold=repair_threshold,
        rank_tolerance=rank_tolerance,
    )
    timed = Stopwatch()
    with staged_folder(out) as folder, TemporaryDirectory(dir=folder) as scratch:
        with timed("load the scene"):
            scenario = scenes.load(scene, hidden, define)
        with timed("read the frames"):
            used = masks.read(mask, scenario)
            sequence = open_frames(frames, scenario.photograph_shape, used)
            check_left_over(out, len(sequence))
            photographs, warnings = decoded_photographs(sequence, scenario, Path(scratch, "y.npy"))
            defects = defective_pixels(photographs[0], used)
            first = f"{frames}, first frame"
            warnings += masks.warn_of(defects, first, out / masks.SUGGESTED)
            known = None
            if truth is not None:
                known = decoded_truth(truth, scenario, len(sequence), Path(scratch, "truth.npy"))
        with timed("transport matrix"):
            if matrix is not None:
                A = scenes.read_transport(matrix, scenario)
            else:
                A = scenes.transport(scenario, samples, seed, model)
        with timed("fit the method"), mendable(str(matrix or f"scene '{scenario.path}'")):
            B = point_light_backgrounds(scenario)
            recovery = fitted(method, coupling, weights, settings, scenario, A, B, used)
        if matrix is not None and not matrix.with_suffix(".json").is_file():
            warn(f"{matrix} has no JSON file beside it: it may be of another scene of this size")
        file = folder / "frames.npy"
        # Products this small gain little from threads, which wait for each other on a busy machine.
        with threadpool_limits(1), mendable(str(frames)):
            with timed("rehearse"):
                live = live_rate(recovery.video, photographs)
            with timed("reconstruct"):
                solved = solutions(recovery.video, photographs, batch)
                images, records = _written(file, solved, sequence.names, scenario.hidden_shape)
        provenance = scenes.provenance_of(scenario, seed)
        text = as_text(provenance)
        with timed("draw"):
            white = white_of(images)
            if known is not None:
                compare(records, images, known)
                draw_sheet(folder / "frames_sheet.png", photographs, known, images, records, text)
            draw_frames(folder / "frames", images, white, text)
            draw_video(folder / "video.png", photographs, images, known, white, rate, text)
        masks.suggest(folder, defects, used, text)
        write_table(folder / "metrics.csv", records)
        medians = medians_of(records)
        rates = {"batch": len(records) / sum(r["seconds"] for r in records), "live": live}
        summary: dict[str, Any] = {
            "photographs": str(frames),
            "frames": len(sequence),
            "photograph_shape": scenario.photograph_shape,
            "hidden_shape": scenario.hidden_shape,
            "model": "file" if matrix else model.value,
            "transport": matrix,
            "samples": None if matrix else samples,
            **recovery.settings,
            "batch": batch,
            "rate": rate,
            "white": white,
            **masks.record(mask, used),
            "warnings": warnings,
            "truth": truth,
            "median": medians,
            "frames_per_second": rates,
            "seconds": timed.seconds,
            "provenance": provenance,
        }
        write_json(folder / "summary.json", summary)
        written = sorted(file.name for file in folder.iterdir() if file != Path(scratch))
    say(f"wrote {', '.join(str(out / name) for name in written)}")
    say(
        f"{len(records)} frames, {rates['batch']:.1f} a second in batches of {batch}, "
        f"{rates['live']:.1f} one at a time"
    )
    if known is not None:
        say(f"against the truth: median gain-matched PSNR {medians['psnr']:.2f} dB")


def _written(
    file: Path,
    solved: Iterator[tuple[Solution, float]],
    names: Sequence[str],
    hidden_shape: tuple[int, int],
) -> tuple[Image, list[Record]]:
    """Write each frame as it is recovered; return all of them, mapped, and a record of each."""
    from periscopy_sim.storage.sequences.stacks import mapped_stack, npy_writer

    count = len(names)
    shape = (count, *hidden_shape, 3)
    records: list[Record] = []
    with (
        _frame_progress("reconstructing", count) as report,
        npy_writer(file, shape, np.float32) as write,
    ):
        for k, (name, (solution, seconds)) in enumerate(zip(names, solved, strict=True)):
            write(solution.image)
            records.append(record_of(k, name, solution, seconds))
            report(k + 1)
    return mapped_stack(file), records


@contextmanager
def _frame_progress(label: str, count: int) -> Iterator[Callable[[int], None]]:
    """Show on a terminal how many frames are done, and how many a second."""
    from rich.console import Console
    from rich.progress import BarColumn, MofNCompleteColumn, Progress, TextColumn
    from rich.progress import TimeRemainingColumn as Remaining

    columns = (
        TextColumn("{task.description}"), BarColumn(), MofNCompleteColumn(),
        TextColumn("{task.fields[rate]}"), Remaining(),
    )  # fmt: skip
    console = Console(stderr=True)
    start = time.perf_counter()
    with Progress(
        *columns, console=console, transient=True, disable=not console.is_terminal
    ) as bar:
        task = bar.add_task(label, total=count, rate="")

        def report(done: int) -> None:
            rate = done / (time.perf_counter() - start)
            bar.update(task, completed=done, rate=f"{rate:.1f} frames/s")

        yield report
