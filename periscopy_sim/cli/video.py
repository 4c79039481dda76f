"""`periscopy video`: from a sequence of photographs to the hidden video."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Annotated, Any

import numpy as np
import typer

from periscopy_sim.cli import arguments, inputs
from periscopy_sim.cli.arguments import option
from periscopy_sim.cli.fitting.fit import fit
from periscopy_sim.cli.fitting.prototypes import AskedPrototypes, PrototypesOption
from periscopy_sim.cli.fitting.transport_matrix import (
    AskedTransport,
    BouncesOption,
    Model,
    ModelOption,
    parse_bounces,
)
from periscopy_sim.cli.method_options import (
    COUPLINGS,
    FOR_VIDEOS,
    check_coupling,
    coupling_help,
    method_help,
    settings_for,
    takes_options_of,
)
from periscopy_sim.cli.output import (
    Stopwatch,
    counted_progress,
    fixable,
    progress,
    say,
    told_folder,
    warn,
    write_json,
)
from periscopy_sim.errors import OutputError
from periscopy_sim.reconstruction.registry import DEFAULT, METHODS
from periscopy_sim.storage.outputs.provenance import as_text


@takes_options_of(FOR_VIDEOS)
def video(
    frames: Annotated[
        Path,
        typer.Argument(
            metavar="FRAMES",
            help="Photographs in time's order: a folder of files that reconstruct takes, a Zarr "
            "archive, a multi-part EXR, an NPY or NPZ stack (frames, rows, columns, 3).",
        ),
    ],
    scene: arguments.SceneOption,
    hidden: arguments.Hidden,
    out: arguments.Out,
    method: Annotated[
        str,
        option(
            "NAME",
            f"How each frame is recovered. {method_help(FOR_VIDEOS)}.",
            autocompletion=lambda: list(FOR_VIDEOS),
        ),
    ] = DEFAULT,
    coupling: Annotated[
        str,
        option(
            "NAME",
            f"How each frame is tied to the one before it: {coupling_help()}.",
            autocompletion=lambda: list(COUPLINGS),
        ),
    ] = "l1",
    samples: arguments.Samples = 16,
    model: ModelOption = Model.rendered,
    bounces: BouncesOption = "direct",
    matrix: arguments.MatrixOption = None,
    truth: Annotated[
        str | None,
        option(
            "IMAGES",
            "What was hidden, if known: a folder of pictures or an NPY stack, one for each "
            "photograph, or one image (a file or a shipped one) for all; adds metrics and "
            "frames_sheet.png.",
        ),
    ] = None,
    rate: Annotated[
        float,
        option(
            "NUMBER", "Animation's frames a second.", min=0.1, max=1000, callback=arguments.not_nan
        ),
    ] = 16.0,
    also: Annotated[
        list[str] | None,
        option(
            "mp4|webm",
            "Write the animation in this format too, as video.mp4 or video.webm, by PyAV (the "
            "extra video); repeatable.",
        ),
    ] = None,
    batch: Annotated[
        int,
        option("NUMBER", "Photographs that P or A is applied to in one product.", min=1, max=4096),
    ] = 16,
    background: arguments.BackgroundOption = None,
    backgrounds: PrototypesOption = None,
    mask: arguments.MaskOption = None,
    seed: arguments.Seed = 0,
    define: arguments.Define = None,
    **options: float | None,
) -> None:
    """Recover a hidden video from photographs of the wall."""
    from threadpoolctl import threadpool_limits

    from periscopy_sim.evaluation import video_metrics
    from periscopy_sim.evaluation.methods import check_able
    from periscopy_sim.figures import video as drawing
    from periscopy_sim.figures.residual import draw_residual
    from periscopy_sim.shipped import find_image
    from periscopy_sim.storage.formats.arrays import mapped_stack
    from periscopy_sim.storage.sequences import (
        decoded_photographs,
        decoded_truth,
        npy_writer,
        open_frames,
    )

    formats = _formats(also)
    check_coupling(method, coupling)
    settings = settings_for(method, options, FOR_VIDEOS, coupling)
    entry = METHODS[method]
    for_stills = {option.name for option in entry.options} & settings.keys()
    weights = {name: settings[name] for name in settings if name not in for_stills}
    asked = AskedTransport(samples, seed, model, parse_bounces(bounces), matrix)
    prototypes = AskedPrototypes.of(backgrounds, seed, [method])
    timed = Stopwatch()
    with told_folder(out) as folder, TemporaryDirectory(dir=folder) as scratch:
        with timed("load the scene"), progress("loading the scene"):
            scenario = inputs.load(scene, hidden, define)
        check_able(method, scenario.hidden_shape)
        unseen = inputs.warn_without_shadows(scenario, scene)
        unseen += inputs.warn_of_long_patches(scenario, scene)
        with timed("read the frames"), progress("reading the photographs") as report:
            used = inputs.read_mask(mask, scenario)
            dark = inputs.read_backgrounds(background, scenario, used)
            sequence = open_frames(frames, scenario.photograph_shape, used)
            names = drawing.picture_names(len(sequence))
            _check_left_over(out / "frames", names)
            photographs, warnings = decoded_photographs(
                sequence, scenario.photograph_shape, used, Path(scratch, "y.npy"), report
            )
            for warning in warnings:
                warn(warning)
            first = f"{frames}, first frame"
            defects = inputs.look_for_defects(photographs[0], used, first, out / inputs.SUGGESTED)
            used = defects.used
            known = None
            if truth is not None:
                path = Path(truth) if Path(truth).is_dir() else find_image(truth)
                known = decoded_truth(
                    path, scenario.hidden_shape, len(sequence), Path(scratch, "truth.npy")
                )
        for_each = {name: settings[name] for name in for_stills}
        still, _ = fit(method, for_each, scenario, used, dark, timed, asked, prototypes)
        recovery = entry.frames_by(still, coupling, **weights)
        records = []
        doubts: dict[str, str] = {}
        # Products this small gain little from threads, which wait for each other on a busy machine.
        with threadpool_limits(1), fixable(str(frames), dark):
            with timed("rehearse"):
                live = video_metrics.live_rate(recovery, photographs)
            with (
                timed("reconstruct"),
                counted_progress("reconstructing", "frames") as frame_done,
                npy_writer(
                    folder / "frames.npy", (len(names), *scenario.hidden_shape, 3), np.float32
                ) as write,
            ):
                solved = video_metrics.timed_solutions(recovery, photographs, batch)
                for k, (solution, seconds) in enumerate(solved):
                    write(solution.image)
                    if k == 0:
                        residual = still.residual(photographs[0], solution)
                    told = solution.told()
                    if doubt := still.doubt(solution):
                        doubts[sequence.names[k]] = doubt
                    records.append(video_metrics.record_of(k, sequence.names[k], seconds, told))
                    frame_done(k + 1, len(names))
        doubted = _counted(str(frames), doubts)
        for doubt in doubted:
            warn(doubt)
        if warning := defects.else_warned(residual):
            warn(f"{first}: {warning}")
            doubted.append(f"{first}: {warning}")
        images = mapped_stack(folder / "frames.npy")
        provenance = inputs.provenance_of(scenario, seed)
        text = as_text(provenance)
        with timed("draw"):
            white = drawing.white_of(images)
            if known is not None:
                video_metrics.compare(records, images, known)
                errors = [record["mean_squared_error"] for record in records]
                drawing.draw_sheet(
                    folder / "frames_sheet.png", photographs, known, images, errors, text
                )
            with progress("drawing the frames") as report:
                drawing.draw_frames(folder / "frames", images, white, text, report)
            for ending in formats:
                with progress(f"drawing the animation as {ending}") as report:
                    drawing.draw_video(
                        folder / f"video.{ending}",
                        *(photographs, images, known, white, rate, text, report),
                    )
        if residual is not None:
            draw_residual(folder / "residual.png", photographs[0], residual, text)
        defects.suggest_mask(folder, text)
        video_metrics.write_table(folder / "metrics.csv", records)
        medians = video_metrics.medians_of(records)
        rates = {"batch": len(records) / sum(r["seconds"] for r in records), "live": live}
        summary: dict[str, Any] = {
            "photographs": str(frames),
            "frames": len(sequence),
            "photograph_shape": scenario.photograph_shape,
            "hidden_shape": scenario.hidden_shape,
            **asked.origin,
            **prototypes.origin,
            "method": method,
            **settings,
            **still.fitted(),
            "first_frame": {} if residual is None else residual.told(),
            "coupling": coupling,
            "batch": batch,
            "rate": rate,
            "formats": formats,
            "white": white,
            **inputs.mask_record(mask, used),
            "backgrounds": list(dark),
            "warnings": [*unseen, *warnings, *defects.warnings, *doubted],
            "truth": truth,
            "median": medians,
            "frames_per_second": rates,
            "seconds": timed.seconds,
            "provenance": provenance,
        }
        write_json(folder / "summary.json", summary)
    if residual is not None:
        say(f"first frame, {residual.remark}")
    say(
        f"{len(records)} frames, {rates['batch']:.1f} a second in batches of {batch}, "
        f"{rates['live']:.1f} one at a time"
    )
    if known is not None:
        say(f"against the truth: median gain-matched PSNR {medians['psnr']:.2f} dB")


def _formats(also: list[str] | None) -> list[str]:
    """Return the endings of all the files of the animation; refuse one that cannot be written."""
    from periscopy_sim.figures.movie import require_encoder

    for ending in also or []:
        require_encoder(ending)
    return ["png", *dict.fromkeys(also or [])]


def _counted(frames: str, doubts: Mapping[str, str]) -> list[str]:
    """Return one line of the frames in doubt: why the first is, and how many others are."""
    if not doubts:
        return []
    name, why = next(iter(doubts.items()))
    others = f" (likewise {len(doubts) - 1} more)" if len(doubts) > 1 else ""
    return [f"{frames}, frame {name}: {why}{others}"]


def _check_left_over(folder: Path, names: list[str]) -> None:
    """Refuse a folder whose pictures would be taken for those of this video."""
    left_over = sorted({file.name for file in folder.glob("*.png")} - set(names))
    if left_over:
        raise OutputError(
            f"{folder / left_over[0]} is of a longer video; remove {folder}, or name another folder"
        )
