"""`periscopy video`: from a sequence of photographs to the hidden video."""

from __future__ import annotations

from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Annotated, Any

import numpy as np
import typer

from periscopy_sim.cli import inputs, options
from periscopy_sim.cli.light import LightModel, TransportRequest
from periscopy_sim.cli.method_options import (
    COUPLINGS,
    FOR_VIDEOS,
    check_coupling,
    coupling_help,
    method_help,
    settings_for,
    takes_options_of,
)
from periscopy_sim.cli.options import OUTPUT, PHOTOGRAPH, SOLVER, number, option
from periscopy_sim.cli.output import counted_progress, fixable, progress, say, told_folder
from periscopy_sim.cli.session import Session
from periscopy_sim.errors import OutputError
from periscopy_sim.reconstruction.registry import DEFAULT, METHODS


@takes_options_of(FOR_VIDEOS)
def video(
    frames: Annotated[
        Path,
        typer.Argument(
            metavar="FRAMES",
            help="Photographs in time's order: a folder of files that reconstruct takes, a Zarr "
            "archive, a multi-part EXR, an NPY or NPZ stack (frames, rows, columns, 3).",
            rich_help_panel=PHOTOGRAPH,
        ),
    ],
    scene: options.SceneOption,
    hidden: options.Hidden,
    out: options.Out,
    method: Annotated[
        str,
        option(
            "NAME",
            f"How each frame is recovered. {method_help(FOR_VIDEOS)}.",
            group=SOLVER,
            autocompletion=lambda: list(FOR_VIDEOS),
        ),
    ] = DEFAULT,
    coupling: Annotated[
        str,
        option(
            "NAME",
            f"How each frame is tied to the one before it: {coupling_help()}.",
            group=SOLVER,
            autocompletion=lambda: list(COUPLINGS),
        ),
    ] = "l1",
    samples: options.Samples = 16,
    model: options.ModelOption = options.Model.rendered,
    bounces: options.BouncesOption = "direct",
    matrix: options.MatrixOption = None,
    truth: Annotated[
        str | None,
        option(
            "IMAGES",
            "The hidden images, if known: a folder of pictures or an NPY stack, one for each "
            "photograph, or one image (a file or a shipped one) for all; adds metrics and "
            "frames_sheet.png.",
        ),
    ] = None,
    rate: Annotated[
        float, number("Animation's frames a second.", group=OUTPUT, min=0.1, max=1000)
    ] = 16.0,
    also: Annotated[
        list[str] | None,
        option(
            "mp4|webm",
            "Write the animation in this format too, as video.mp4 or video.webm, by PyAV (the "
            "extra video); repeatable.",
            group=OUTPUT,
        ),
    ] = None,
    batch: Annotated[
        int,
        option(
            "NUMBER",
            "Photographs that P or A is applied to in one product.",
            group=options.EXPERT,
            min=1,
            max=4096,
        ),
    ] = 16,
    monitor_off: options.MonitorOffOption = None,
    light_model: options.LightModelOption = None,
    mask: options.MaskOption = None,
    seed: options.Seed = 0,
    define: options.Define = None,
    **numbers: float | None,
) -> None:
    """Recover a hidden video from photographs of the wall."""
    from threadpoolctl import threadpool_limits

    from periscopy_sim.evaluation import video_metrics
    from periscopy_sim.figures import video as drawing
    from periscopy_sim.figures.residual import draw_residual
    from periscopy_sim.shipped import find_image
    from periscopy_sim.storage.sequences.hidden_frames import decoded_truth
    from periscopy_sim.storage.sequences.opening import decoded_photographs, open_frames
    from periscopy_sim.storage.sequences.stacks import mapped_stack, npy_writer

    formats = _formats(also)
    check_coupling(method, coupling)
    settings = settings_for(method, numbers, FOR_VIDEOS, coupling)
    entry = METHODS[method]
    names_for_stills = {option.name for option in entry.options} & settings.keys()
    for_stills = {name: settings[name] for name in names_for_stills}
    weights = {name: settings[name] for name in settings if name not in for_stills}
    request = TransportRequest(samples, seed, model, options.parse_bounces(bounces), matrix)
    lights = LightModel.of(light_model, seed, [method])
    session = Session(scene, hidden, define, seed)
    timed = session.timed
    with told_folder(out) as folder, TemporaryDirectory(dir=folder) as scratch:
        session.check_scene(method)
        scenario = session.scenario
        with timed("read the frames"), progress("reading the photographs") as report:
            used = inputs.read_mask(mask, scenario)
            dark = inputs.read_backgrounds(monitor_off, scenario, used)
            sequence = open_frames(frames, scenario.photograph_shape, used)
            names = drawing.picture_names(len(sequence))
            _check_left_over(out / "frames", names)
            photographs, warnings = decoded_photographs(
                sequence, scenario.photograph_shape, used, Path(scratch, "y.npy"), report
            )
            for warning in warnings:
                session.warn(warning)
            first = f"{frames}, first frame"
            wall = session.checked_wall(
                photographs[0], first, mask, used, dark, suggested=out / inputs.SUGGESTED
            )
            known = None
            if truth is not None:
                path = Path(truth) if Path(truth).is_dir() else find_image(truth)
                known = decoded_truth(
                    path, scenario.hidden_shape, len(sequence), Path(scratch, "truth.npy")
                )
        still, _ = session.fit(method, for_stills, request, lights, wall)
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
        for name, doubt in list(doubts.items())[:1]:
            others = f" (likewise {len(doubts) - 1} more)" if len(doubts) > 1 else ""
            session.warn(f"{frames}, frame {name}: {doubt}{others}")
        if warning := wall.defects.else_warned(residual):
            session.warn(f"{first}: {warning}")
        images = mapped_stack(folder / "frames.npy")
        text = session.metadata
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
        wall.defects.suggest_mask(folder, text)
        video_metrics.write_table(folder / "metrics.csv", records)
        medians = video_metrics.medians_of(records)
        rates = {"batch": len(records) / sum(r["seconds"] for r in records), "live": live}
        summary: dict[str, Any] = {
            "photographs": str(frames),
            "frames": len(sequence),
            **request.origin,
            **lights.origin,
            "method": method,
            **settings,
            **still.fitted(),
            "first_frame": {} if residual is None else residual.told(),
            "coupling": coupling,
            "batch": batch,
            "rate": rate,
            "formats": formats,
            "white": white,
            **wall.record,
            "truth": truth,
            "median": medians,
            "frames_per_second": rates,
        }
        session.write_summary(folder / "summary.json", summary)
    if residual is not None:
        say(f"first frame, {residual.remark}")
    say(
        f"{len(records)} frames, {rates['batch']:.1f} a second in batches of {batch}, "
        f"{rates['live']:.1f} one at a time"
    )
    if known is not None:
        say(f"against the truth: median gain-matched PSNR {medians['psnr']:.2f} dB")


def _formats(also: list[str] | None) -> list[str]:
    """Return the suffixes of the animation's files; check that each can be written."""
    from periscopy_sim.figures.movie import require_encoder

    for ending in also or []:
        require_encoder(ending)
    return ["png", *dict.fromkeys(also or [])]


def _check_left_over(folder: Path, names: list[str]) -> None:
    """Reject a folder with pictures of a longer video."""
    left_over = sorted({file.name for file in folder.glob("*.png")} - set(names))
    if left_over:
        raise OutputError(
            f"{folder / left_over[0]} is of a longer video; remove {folder}, or name another folder"
        )
