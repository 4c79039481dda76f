"""`periscopy video`: from a sequence of photographs to the hidden video."""

from __future__ import annotations

import os
import time
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from enum import StrEnum
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
from periscopy_sim.cli.video_metrics import Record, compare, medians_of, record_of, write_table
from periscopy_sim.cli.video_pictures import draw_frames, draw_sheet, draw_video, white_of
from periscopy_sim.errors import PeriscopyError

if TYPE_CHECKING:
    from periscopy_sim.evaluation.figures import Image
    from periscopy_sim.reconstruction.periscope import Reconstruction
    from periscopy_sim.reconstruction.video import Video

LIVE_FRAMES = 16
"""Most frames on which the rate of frames that come one at a time is measured."""

BYTES_FOR_P = 24
"""For each entry of A, while P is formed: A and P in single precision, each in double beside."""


class Coupling(StrEnum):
    """How a frame is tied to the one before it; see `Video`."""

    total_variation = "total-variation"
    l1 = "l1"
    none = "none"


WEIGHTS = {"temporal_weight": Coupling.total_variation, "l1_weight": Coupling.l1}
"""The coupling that each weight belongs to."""


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
    coupling: Annotated[
        Coupling, typer.Option(help="How each frame is denoised with the one before it.")
    ] = Coupling.l1,
    temporal_weight: Annotated[
        float | None,
        typer.Option(
            min=0,
            max=1e9,
            callback=_not_nan,
            help="Weight of differences in time within total variation.",
        ),
    ] = None,
    l1_weight: Annotated[
        float | None,
        typer.Option(
            min=0,
            max=1e9,
            callback=_not_nan,
            help="Weight of the l1 difference to the frame before, over that of TV.",
        ),
    ] = None,
    samples: Samples = 16,
    model: scenes.ModelOption = scenes.Model.rendered,
    matrix: Annotated[
        Path | None,
        typer.Option("--transport", help="Take A from this NPY file rather than render it."),
    ] = None,
    tv_weight: Annotated[
        float,
        typer.Option(
            min=0,
            max=1e9,
            callback=_not_nan,
            help="TV weight, in standard errors of the estimate; 0: none.",
        ),
    ] = 1.0,
    repair_threshold: Annotated[
        float,
        typer.Option(
            min=0,
            max=1e9,
            callback=_not_nan,
            help="Repair patches that differ from their neighbours by more than this part of the "
            "image's 99th percentile.",
        ),
    ] = 0.1,
    rank_tolerance: Annotated[
        float,
        typer.Option(
            min=1e-15,
            max=0.5,
            callback=_not_nan,
            help="Relative tolerance on B's singular values.",
        ),
    ] = 1e-10,
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
        int, typer.Option(min=1, max=4096, help="Photographs that P is applied to in one product.")
    ] = 16,
    mask: masks.MaskOption = None,
    seed: Seed = 0,
    define: Define = None,
) -> None:
    """Recover a hidden video from a sequence of photographs of the wall."""
    from threadpoolctl import threadpool_limits

    from periscopy_sim.analytic.point_light import point_light_backgrounds
    from periscopy_sim.defects import defective_pixels
    from periscopy_sim.reconstruction.periscope import Periscope
    from periscopy_sim.reconstruction.video import Video
    from periscopy_sim.storage.frames import open_frames
    from periscopy_sim.storage.output import staged_folder
    from periscopy_sim.storage.provenance import as_text

    weights = _weights(coupling, temporal_weight=temporal_weight, l1_weight=l1_weight)
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
        explicit = _fits_in_memory(BYTES_FOR_P * A.size)
        with (
            timed("form the preconditioner"),
            mendable(str(matrix or f"scene '{scenario.path}'")),
        ):
            periscope = Periscope.for_scene(
                scenario,
                A,
                point_light_backgrounds(scenario),
                tolerance=rank_tolerance,
                tv_weight=tv_weight,
                repair_threshold=repair_threshold,
                explicit=explicit,
                mask=used,
            )
        if matrix is not None and not matrix.with_suffix(".json").is_file():
            warn(f"{matrix} has no JSON file beside it: it may be of another scene of this size")
        method = Video(periscope, coupling=coupling.value, **weights)
        file = folder / "frames.npy"
        # Products this small gain little from threads, which wait for each other on a busy machine.
        with threadpool_limits(1), mendable(str(frames)):
            with timed("rehearse"):
                live = _live_rate(method, photographs)
            with timed("reconstruct"):
                images, records = _reconstructed(method, photographs, sequence.names, batch, file)
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
            "tv_weight": tv_weight,
            "repair_threshold": repair_threshold,
            "rank_tolerance": rank_tolerance,
            "background_rank": periscope.preconditioner.Q.shape[1],
            "explicit": explicit,
            "coupling": coupling.value,
            **{n: getattr(method, n) for n, owner in WEIGHTS.items() if owner is coupling},
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


# -- what is given -------------------------------------------------------------------------------


def _weights(coupling: Coupling, **given: float | None) -> dict[str, float]:
    """Keep the weights that are given.

    Raises
    ------
    PeriscopyError
        If one belongs to another coupling.
    """
    weights = {name: value for name, value in given.items() if value is not None}
    for name in weights:
        if WEIGHTS[name] is not coupling:
            raise PeriscopyError(
                f"--{name.replace('_', '-')} belongs to --coupling {WEIGHTS[name].value}, not to "
                f"{coupling.value}; leave it out"
            )
    return weights


def _fits_in_memory(size: int) -> bool:
    """Tell whether so many bytes are less than half of this machine's memory."""
    try:
        memory = os.sysconf("SC_PAGE_SIZE") * os.sysconf("SC_PHYS_PAGES")
    except (AttributeError, ValueError, OSError):
        return True
    return 2 * size < memory


# -- the reconstruction --------------------------------------------------------------------------


def _live_rate(method: Video, photographs: Image) -> float:
    """Measure frames a second when they come one at a time and the compiled code is loaded."""
    for photograph in photographs[:2]:  # a first frame and one that follows
        method.next_frame(photograph)
    shown = photographs[:LIVE_FRAMES]
    start = time.perf_counter()
    for photograph in shown:
        method.next_frame(photograph)
    seconds = time.perf_counter() - start
    method.restart()
    return len(shown) / seconds


def _reconstructed(
    method: Video, photographs: Image, names: Sequence[str], batch: int, file: Path
) -> tuple[Image, list[Record]]:
    """Write each frame as it is recovered; return all of them, mapped, and a record of each."""
    from periscopy_sim.storage.stacks import mapped_stack, npy_stack

    count = len(photographs)
    shape = (count, *method.periscope.hidden_shape, 3)
    records: list[Record] = []
    with (
        _frame_progress("reconstructing", count) as report,
        npy_stack(file, shape, np.float32) as write,
    ):
        solved = zip(names, _solutions(method, photographs, batch), strict=True)
        for k, (name, (solution, seconds)) in enumerate(solved):
            write(solution.image)
            records.append(record_of(k, name, solution, seconds))
            report(k + 1)
    return mapped_stack(file), records


def _solutions(
    method: Video, photographs: Image, batch: int
) -> Iterator[tuple[Reconstruction, float]]:
    """Frames in turn, with the seconds each took: its own and its share of its batch's product."""
    for start in range(0, len(photographs), batch):
        clock = time.perf_counter()
        estimate = method.periscope.estimate(photographs[start : start + batch])
        share = (time.perf_counter() - clock) / len(estimate.noise)
        for k in range(len(estimate.noise)):
            clock = time.perf_counter()
            solution = method.finish(estimate, k)
            yield solution, share + time.perf_counter() - clock


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
