"""`periscopy video`: from a sequence of photographs to the hidden video."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import TYPE_CHECKING, Annotated, Any

import numpy as np
import typer
from numpy.typing import NDArray

from periscopy_sim.cli import options
from periscopy_sim.cli.light import LightModel, TransportRequest
from periscopy_sim.cli.messages import residual_summary, sentences
from periscopy_sim.cli.method_options import (
    FOR_VIDEOS,
    Coupling,
    VideoMethod,
    check_coupling,
    settings_for,
    takes_options_of,
)
from periscopy_sim.cli.options import EXPERT, OUTPUT, PHOTOGRAPH, number, option
from periscopy_sim.cli.output import fixable, output_folder, progress, say
from periscopy_sim.cli.session import SUGGESTED, Session, pixel_record
from periscopy_sim.errors import OutputError
from periscopy_sim.photograph import Photograph
from periscopy_sim.reconstruction.registry import DEFAULT, METHODS

if TYPE_CHECKING:
    from periscopy_sim.reconstruction.report import Report


@takes_options_of(FOR_VIDEOS)
def video(
    frames: Annotated[
        Path,
        typer.Argument(
            metavar="FRAMES",
            help="Photographs in time's order: a folder of files that reconstruct takes, a Zarr "
            "archive, an NPY or NPZ stack (frames, rows, columns, 3).",
            rich_help_panel=PHOTOGRAPH,
        ),
    ],
    scene: options.SceneOption,
    hidden: options.Hidden,
    out: options.Out,
    method: VideoMethod = DEFAULT,
    coupling: Coupling = "l1",
    samples: options.RaysOption = None,
    model: options.ClosedOption = None,
    bounces: options.BouncesOption = "direct",
    matrix: options.MatrixOption = None,
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
    light_model: options.LightModelOption = None,
    mask: options.MaskOption = None,
    colour_matrix: options.ColourMatrixOption = None,
    seed: options.Seed = 0,
    define: options.Define = None,
    **numbers: float | None,
) -> None:
    """Recover a hidden video from photographs of the wall."""
    from periscopy_sim.evaluation import video_metrics
    from periscopy_sim.figures import video as drawing
    from periscopy_sim.figures.animation import require_encoder
    from periscopy_sim.figures.residual import draw_residual
    from periscopy_sim.storage.colour_matrix import read_colour_matrix

    for ending in also or ():
        require_encoder(ending)
    formats = ["png", *dict.fromkeys(also or ())]
    check_coupling(method, coupling)
    settings = settings_for(method, numbers, FOR_VIDEOS, coupling)
    entry = METHODS[method]
    of_still = {option.name for option in entry.options}
    for_stills = {name: value for name, value in settings.items() if name in of_still}
    weights = {name: value for name, value in settings.items() if name not in of_still}
    request = TransportRequest(
        samples, seed, model, options.parse_bounces(bounces), matrix, method=method
    )
    lights = LightModel.of(light_model, seed, [method])
    colours = None if colour_matrix is None else read_colour_matrix(colour_matrix)
    session = Session(scene, hidden, define, seed)
    with output_folder(out) as folder, TemporaryDirectory(dir=folder) as scratch:
        session.check_scene(method)
        clip = _read_clip(session, frames, mask, monitor_off, truth, out, Path(scratch))
        still = session.fit(method, for_stills, request, lights, clip.wall, colour_matrix=colours)
        recovery = entry.frames_by(still, coupling, **weights)
        images, records, report, rates = _recover(
            session, recovery, still, clip, folder / "frames.npy", batch
        )
        residual = report.residual
        text = session.metadata
        with session.timed("draw"):
            white = drawing.white_of(images)
            if clip.truth is not None:
                video_metrics.compare(records, images, clip.truth)
                drawing.draw_sheet(
                    folder / "frames_sheet.png", clip.photographs, clip.truth, images,
                    [record["mean_squared_error"] for record in records], text,
                )  # fmt: skip
            with progress("drawing the frames") as drawn:
                drawing.draw_frames(folder / "frames", images, white, text, drawn)
            for ending in formats:
                with progress(f"drawing the animation as {ending}") as drawn:
                    drawing.draw_video(
                        folder / f"video.{ending}",
                        *(clip.photographs, images, clip.truth, white, rate, text, drawn),
                    )
        if residual is not None:
            caption = residual_summary(residual)
            draw_residual(folder / "residual.png", clip.photographs[0], residual, caption, text)
        session.suggest_mask(folder)
        video_metrics.write_table(folder / "metrics.csv", records)
        medians = video_metrics.medians_of(records)
        summary = {
            "photographs": clip.name,
            "frames": len(clip.names),
            **request.origin(session.scenario),
            **lights.origin,
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
    if residual is not None:
        say(f"first frame, {residual_summary(residual)}")
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
    wall: Photograph  # of the first frame
    truth: NDArray[np.floating[Any]] | None  # (frames, R, C, 3)


def _read_clip(
    session: Session,
    frames: Path,
    mask: Path | None,
    monitor_off: list[Path] | None,
    truth: str | None,
    out: Path,
    scratch: Path,
) -> _Clip:
    """Read and check the photographs and the hidden images, into files of a scratch folder."""
    from periscopy_sim.figures.video import picture_names
    from periscopy_sim.shipped import find_image
    from periscopy_sim.storage.sequences import decoded_photographs, decoded_truth, open_frames

    scenario = session.scenario
    shape = scenario.photograph_shape
    with session.timed("read the frames"), progress("reading the photographs") as report:
        used, off = session.companions(mask, monitor_off)
        sequence = open_frames(frames, shape, used)
        held = {file.name for file in (out / "frames").glob("*.png")}
        if held - set(picture_names(len(sequence))):
            raise OutputError(f"{out}: holds a longer video; name another folder")
        photographs, warnings = decoded_photographs(
            sequence, shape, used, scratch / "y.npy", report
        )
        for warning in warnings:
            session.warn(warning)
        wall = session.without_defects(
            Photograph(photographs[0], used, off),
            f"{frames}, first frame",
            suggested=out / SUGGESTED,
        )
        known = None
        if truth is not None:
            path = Path(truth) if Path(truth).is_dir() else find_image(truth)
            known = decoded_truth(path, scenario.hidden_shape, len(sequence), scratch / "truth.npy")
    return _Clip(str(frames), sequence.names, photographs, wall, known)


def _recover(
    session: Session, recovery: Any, still: Any, clip: _Clip, file: Path, batch: int
) -> tuple[NDArray[np.floating[Any]], list[dict[str, Any]], Report, dict[str, float]]:
    """Recover the frames into an NPY file; print the warnings of the first.

    Return the frames, (frames, R, C, 3), their rows of the table, the first one's report, and rates
    in frames a second.
    """
    from threadpoolctl import threadpool_limits

    from periscopy_sim.evaluation import video_metrics
    from periscopy_sim.reconstruction.report import Report
    from periscopy_sim.storage.formats.arrays import mapped_stack
    from periscopy_sim.storage.sequences import npy_writer

    count, shape = len(clip.names), session.scenario.hidden_shape
    records: list[dict[str, Any]] = []
    report = Report()
    # Small products gain little from threads, which wait for each other on a busy machine.
    with threadpool_limits(1), fixable(clip.name, clip.wall.monitor_off):
        with session.timed("rehearse"):
            live = video_metrics.live_rate(recovery, clip.photographs)
        with (
            session.timed("reconstruct"),
            progress("reconstructing", "frames") as frame_done,
            npy_writer(file, (count, *shape, 3), np.float32) as write,
        ):
            solved = video_metrics.timed_solutions(recovery, clip.photographs, batch)
            for k, (solution, seconds) in enumerate(solved):
                write(solution.image)
                if k == 0:
                    report = still.report(clip.photographs[0], solution)
                numbers = solution.numbers()
                records.append(video_metrics.record_of(k, clip.names[k], seconds, numbers))
                frame_done(k + 1, count)
    for warning in sentences(report.warnings):
        session.warn(f"{clip.name}, first frame: {warning}")
    rates = {"batch": count / sum(record["seconds"] for record in records), "live": live}
    return mapped_stack(file), records, report, rates
