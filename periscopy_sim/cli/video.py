"""`periscopy video`: from a sequence of photographs to the hidden video."""

from collections.abc import Sequence
from pathlib import Path
from typing import Annotated, Any

import numpy as np

import periscopy_sim as ps
from periscopy_sim.cli import options
from periscopy_sim.cli.light import LightOptions
from periscopy_sim.cli.options import OUTPUT, argument, option
from periscopy_sim.cli.output import conclude, fixable, output_folder, progress, show_table
from periscopy_sim.cli.reconstruct import draw_residual
from periscopy_sim.cli.session import PhotoSession, Session
from periscopy_sim.figures import animation
from periscopy_sim.hidden import named
from periscopy_sim.numerics import Image
from periscopy_sim.reconstruction.registry import DEFAULT, METHODS
from periscopy_sim.storage import sequences

OPTIONAL = (
    *("frames*/*.png", "frames*.npy", "frames_sheet.png", "residual.png"),
    *("video.mp4", "video.webm"),
)
"""Files that depend on the scene, the options and the number of frames."""

_TRUTH = "The hidden images: a folder, an NPY stack, or one image; of several surfaces of each."
_RATE = "Frames a second of the animation."
_ALSO = "A further animation; repeatable."
_FRAMES = "Photographs in time's order: a folder, a Zarr archive, an NPY or NPZ stack."


def video(
    *,
    frames: Annotated[Path, argument("FRAMES", _FRAMES, exists=True)],
    session: PhotoSession,
    light: LightOptions,
    matrix: options.MatrixOption = None,
    out: options.Out,
    method: options.VideoMethodOption = DEFAULT,
    coupling: options.Coupling = "l1",
    numbers: options.VideoNumbers,
    truth: Annotated[list[str] | None, option("[ID=]IMAGES", _TRUTH)] = None,
    rate: Annotated[float, option("NUMBER", _RATE, group=OUTPUT, kind="rate")] = 16.0,
    also: Annotated[list[str] | None, option("mp4|webm", _ALSO, group=OUTPUT)] = None,
) -> None:
    """Recover a hidden video from photographs of the wall."""
    from periscopy_sim.evaluation import video_metrics

    for ending in also or ():
        animation.require_encoder(ending)
    formats = ["png", *dict.fromkeys(also or ())]
    settings = options.settings_for(method, numbers.values, options.FOR_VIDEOS, coupling)
    entry = METHODS[method]
    for_still = {each.name: settings.pop(each.name) for each in entry.options}
    light.check_methods(method)
    with output_folder(out, OPTIONAL) as folder:
        session.check_scene(method)
        names, photographs, wall = _read(session, frames)
        shown, known = session.by_surface(truth, "--truth") if truth else {}, dict[str, Image]()
        for surface, text in shown.items():
            path = Path(text) if Path(text).is_dir() else ps.find_image(text)
            size = session.scenario.hidden[surface].shape
            known[surface] = np.stack([*sequences.read_hidden_frames(path, size, len(names))])
        scenario = session.lit(light, matrix)
        still = session.fit(method, for_still, scenario, wall)
        recovery = entry.frames_by(still, coupling, **settings)
        with fixable(f"{frames}, first frame"):
            images, records, first = _recover(session, recovery, names, photographs)
            report = scenario.judge(wall, first, still)
            verdict, colour = session.judge(f"{frames}, first frame", report)
        flat = np.concatenate([f.reshape(len(f), -1, f.shape[-1]) for f in images.values()], axis=1)
        metadata, white = session.metadata, animation.white_of(flat)
        walls = np.where(wall.pixels[..., np.newaxis], photographs, np.nan)
        with session.timed("draw"):
            for of, name in named("", {name: name for name in known}).items():
                video_metrics.compare(records, images[name], known[name], of)
            if known:
                sheet = folder / "frames_sheet.png"
                animation.draw_sheet(sheet, walls, known, images, metadata)
            for stem, stack in named("frames", images).items():
                np.save(folder / f"{stem}.npy", stack)
                with progress("drawing the frames") as drawn:
                    animation.draw_frames(folder / stem, stack, white, metadata, drawn)
            for ending in formats:
                with progress(f"drawing the animation as {ending}") as drawn:
                    file = folder / f"video.{ending}"
                    animation.draw_video(file, walls, images, known, white, rate, metadata, drawn)
        draw_residual(folder / "residual.png", report, photographs[0], metadata)
        video_metrics.write_table(folder / "metrics.csv", records)
        medians = video_metrics.medians_of(records)
        summary = {
            "photographs": str(frames),
            "frames": len(names),
            **settings,
            "first_frame": report.numbers,
            "verdict": verdict,
            "coupling": coupling,
            "rate": rate,
            "formats": formats,
            "white": white,
            "truth": session.scenario.hidden.unwrapped(shown) if shown else None,
            "median": medians,
            "frames_per_second": 1 / medians["seconds"],
        }
        session.write_summary(folder / "summary.json", summary)
    rows = [["frames", f"{len(names)}"], ["frames a second", f"{1 / medians['seconds']:.1f}"]]
    if known:
        psnr = (f"{medians[f'psnr{of}']:.2f} dB" for of in named("", known))
        rows.append(["median PSNR against the truth", *psnr])
    show_table(rows, ["", *known] if len(known) > 1 else ())
    conclude(f"first frame: {verdict}", colour)


def _read(session: PhotoSession, frames: Path) -> tuple[Sequence[str], Image, ps.Photograph]:
    """Return the frames' names, (frames, rows, columns, C) values, and the first one."""
    shape = session.scenario.photograph_shape
    with session.timed("read the frames"), progress("reading the photographs") as report:
        mask, monitor_off = session.companions()
        sequence = sequences.open_frames(frames, shape, mask)
        photographs, warnings = sequences.read_clip(sequence, report)
    session.warn(*warnings)
    first = ps.Photograph(photographs[0], mask, monitor_off, session.colours)
    return sequence.names, photographs, session.without_defects(first, f"{frames}, first frame")


def _recover(
    session: Session, recovery: Any, names: Sequence[str], photographs: Image
) -> tuple[dict[str, Image], list[dict[str, Any]], Any]:
    """Return frames, (K, R, C, channels) by id, their rows of the table, the first's solution."""
    from threadpoolctl import threadpool_limits

    from periscopy_sim.evaluation import video_metrics

    images: list[dict[str, Image]] = []
    hidden = session.scenario.hidden
    first: Any = None
    records: list[dict[str, Any]] = []
    # Small products gain little from threads, which wait for each other on a busy machine.
    work = progress("reconstructing", "frames")
    with threadpool_limits(1), session.timed("reconstruct"), work as frame_done:
        solved = video_metrics.timed_solutions(recovery, photographs)
        for k, (solution, seconds) in enumerate(solved):
            images.append(hidden.images(solution.image))
            first = solution if k == 0 else first
            numbers = video_metrics.record_of(seconds, solution.numbers())
            records.append({"frame": k, "name": names[k], **numbers})
            frame_done(k + 1, len(names))
    stacks = {n: np.stack([each[n] for each in images]).astype(np.float32) for n in hidden}
    return stacks, records, first
