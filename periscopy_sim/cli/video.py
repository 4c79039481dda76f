"""`periscopy video`: from a sequence of photographs to the hidden video."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import numpy as np
import typer
from numpy.typing import NDArray

import periscopy_sim as ps
from periscopy_sim.cli import options
from periscopy_sim.cli.light import Light
from periscopy_sim.cli.messages import residual_summary, sentences
from periscopy_sim.cli.method_options import (
    FOR_VIDEOS,
    Coupling,
    VideoMethod,
    VideoNumbers,
    check_coupling,
    settings_for,
)
from periscopy_sim.cli.options import EXPERT, OUTPUT, PHOTOGRAPH, number, option
from periscopy_sim.cli.output import fixable, output_folder, progress, say
from periscopy_sim.cli.session import PhotoSession, Session, pixel_record
from periscopy_sim.errors import OutputError
from periscopy_sim.figures import video as drawing
from periscopy_sim.figures.animation import require_encoder
from periscopy_sim.figures.residual import draw_residual
from periscopy_sim.reconstruction.registry import DEFAULT, METHODS
from periscopy_sim.shipped import find_image
from periscopy_sim.storage import sequences

if TYPE_CHECKING:
    from periscopy_sim.reconstruction.report import Report


def video(
    *,
    frames: Annotated[
        Path,
        typer.Argument(
            metavar="FRAMES",
            help="Photographs in time's order: a folder, a Zarr archive, an NPY or NPZ stack.",
            rich_help_panel=PHOTOGRAPH,
        ),
    ],
    session: PhotoSession,
    light: Light,
    matrix: options.MatrixOption = None,
    out: options.Out,
    method: VideoMethod = DEFAULT,
    coupling: Coupling = "l1",
    numbers: VideoNumbers,
    truth: Annotated[
        str | None, option("IMAGES", "The hidden images: a folder, an NPY stack, or one image.")
    ] = None,
    rate: Annotated[
        float, number("Frames a second of the animation.", group=OUTPUT, min=0.1, max=1000)
    ] = 16.0,
    also: Annotated[
        list[str] | None, option("mp4|webm", "A further animation; repeatable.", group=OUTPUT)
    ] = None,
    batch: Annotated[
        int, option("NUMBER", "Photographs in one product.", group=EXPERT, min=1, max=4096)
    ] = 16,
    monitor_off: options.MonitorOffOption = None,
    mask: options.MaskOption = None,
    colour_matrix: options.ColourMatrixOption = None,
) -> None:
    """Recover a hidden video from photographs of the wall."""
    from periscopy_sim.evaluation import video_metrics

    for ending in also or ():
        require_encoder(ending)
    formats = ["png", *dict.fromkeys(also or ())]
    check_coupling(method, coupling)
    settings = settings_for(method, numbers.values, FOR_VIDEOS, coupling)
    entry = METHODS[method]
    of_still = {option.name for option in entry.options}
    for_stills = {name: value for name, value in settings.items() if name in of_still}
    weights = {name: value for name, value in settings.items() if name not in of_still}
    light.check_methods(method)
    colours = None if colour_matrix is None else ps.read_colour_matrix(colour_matrix)
    with output_folder(out) as folder:
        session.check_scene(method)
        light = light.resolved(session.scenario, method)
        clip = _read_clip(session, frames, mask, monitor_off, truth)
        _check_former(out, len(clip.names))
        still = session.fit(method, for_stills, light, matrix, clip.wall, colour_matrix=colours)
        recovery = entry.frames_by(still, coupling, **weights)
        images, records, report, rates = _recover(session, recovery, still, clip, batch)
        np.save(folder / "frames.npy", images)
        text = session.metadata
        with session.timed("draw"):
            white = drawing.white_of(images)
            if clip.truth is not None:
                video_metrics.compare(records, images, clip.truth)
                errors = [record["mean_squared_error"] for record in records]
                sheet = clip.photographs, clip.truth, images, errors, text
                drawing.draw_sheet(folder / "frames_sheet.png", *sheet)
            with progress("drawing the frames") as drawn:
                drawing.draw_frames(folder / "frames", images, white, text, drawn)
            for ending in formats:
                with progress(f"drawing the animation as {ending}") as drawn:
                    shown = clip.photographs, images, clip.truth, white, rate, text, drawn
                    drawing.draw_video(folder / f"video.{ending}", *shown)
        if report.residual is not None:
            caption = residual_summary(report.residual)
            file = folder / "residual.png"
            draw_residual(file, clip.photographs[0], report.residual, caption, text)
        session.suggest_mask(folder)
        video_metrics.write_table(folder / "metrics.csv", records)
        medians = video_metrics.medians_of(records)
        summary = {
            "photographs": str(frames),
            "frames": len(clip.names),
            **light.origin(matrix),
            "method": method,
            **settings,
            "first_frame": report.numbers,
            "coupling": coupling,
            "batch": batch,
            "rate": rate,
            "formats": formats,
            "white": white,
            **pixel_record(mask, clip.wall.mask, clip.wall.monitor_off),
            "colour_matrix": None if colours is None else colours.matrix,
            "truth": truth,
            "median": medians,
            "frames_per_second": rates,
        }
        session.write_summary(folder / "summary.json", summary)
    if report.residual is not None:
        say(f"first frame, {residual_summary(report.residual)}")
    say(
        f"{len(clip.names)} frames, {rates['batch']:.1f} a second in batches of {batch}, "
        f"{rates['live']:.1f} one at a time"
    )
    if truth is not None:
        say(f"against the truth: median gain-matched PSNR {medians['psnr']:.2f} dB")


@dataclass(frozen=True, eq=False)
class _Clip:
    """The photographs of a video, (frames, rows, columns, 3), and their companions."""

    name: str
    names: Sequence[str]  # of the frames
    photographs: NDArray[np.floating[Any]]
    wall: ps.Photograph  # of the first frame
    truth: NDArray[np.floating[Any]] | None  # (frames, R, C, 3)


def _read_clip(
    session: Session,
    frames: Path,
    mask: Path | None,
    monitor_off: list[Path] | None,
    truth: str | None,
) -> _Clip:
    """Read and check the photographs and the hidden images."""
    shape, hidden = session.scenario.photograph_shape, session.scenario.hidden_shape
    with session.timed("read the frames"), progress("reading the photographs") as report:
        used, off = session.companions(mask, monitor_off)
        sequence = sequences.open_frames(frames, shape, used)
        photographs, warnings = sequences.read_clip(sequence, used, report)
        for warning in warnings:
            session.warn(warning)
        name = f"{frames}, first frame"
        wall = session.without_defects(ps.Photograph(photographs[0], used, off), name)
        known = None
        if truth is not None:
            path = Path(truth) if Path(truth).is_dir() else find_image(truth)
            known = np.stack([*sequences.read_hidden_frames(path, hidden, len(sequence))])
    return _Clip(name, sequence.names, photographs, wall, known)


def _check_former(out: Path, count: int) -> None:
    """Reject a folder with pictures of a longer video, which would stay beside the new ones."""
    held = {file.name for file in (out / "frames").glob("*.png")}
    if held - set(drawing.picture_names(count)):
        raise OutputError(f"{out}: holds a longer video; name another folder")


def _recover(
    session: Session, recovery: Any, still: Any, clip: _Clip, batch: int
) -> tuple[NDArray[np.floating[Any]], list[dict[str, Any]], Report, dict[str, float]]:
    """Recover the frames; print the warnings of the first.

    Return the frames, (frames, R, C, 3), their rows of the table, the first one's report, and rates
    in frames a second.
    """
    from threadpoolctl import threadpool_limits

    from periscopy_sim.evaluation import video_metrics
    from periscopy_sim.reconstruction.report import Report

    count, images = len(clip.names), []
    records: list[dict[str, Any]] = []
    report = Report()
    # Small products gain little from threads, which wait for each other on a busy machine.
    with threadpool_limits(1), fixable(clip.name, clip.wall.monitor_off):
        with session.timed("rehearse"):
            live = video_metrics.live_rate(recovery, clip.photographs)
        with session.timed("reconstruct"), progress("reconstructing", "frames") as frame_done:
            solved = video_metrics.timed_solutions(recovery, clip.photographs, batch)
            for k, (solution, seconds) in enumerate(solved):
                images.append(np.asarray(solution.image, np.float32))
                if k == 0:
                    report = still.report(clip.photographs[0], solution)
                numbers = solution.numbers()
                records.append(video_metrics.record_of(k, clip.names[k], seconds, numbers))
                frame_done(k + 1, count)
    for warning in sentences(report.warnings):
        session.warn(f"{clip.name}: {warning}")
    rates = {"batch": count / sum(record["seconds"] for record in records), "live": live}
    return np.stack(images), records, report, rates
