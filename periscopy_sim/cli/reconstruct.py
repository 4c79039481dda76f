"""`periscopy reconstruct` and `periscopy video`: from photographs to the hidden image or video."""

from collections.abc import Mapping, Sequence
from itertools import chain
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import numpy as np

import periscopy_sim as ps
from periscopy_sim.cli import messages, options, output
from periscopy_sim.cli.session import PhotoSession, Session
from periscopy_sim.errors import require_all
from periscopy_sim.figures import animation, panels
from periscopy_sim.hidden import named
from periscopy_sim.numerics import Array, Image
from periscopy_sim.reconstruction.registry import DEFAULT, METHODS
from periscopy_sim.storage import photographs as sequences
from periscopy_sim.storage.formats import libraries_of

if TYPE_CHECKING:
    from periscopy_sim.reconstruction.method import Report, StillMethod

_UNCERTAIN = (
    "Uncertain <default>s with their measurement errors; without =ERROR, the scene's. none: trust "
    "all values. [default: all that have a declared or calibrated error]"
)
_ERRORS = "NAME[=ERROR],...|none"
_TRUTH = f"Hidden image, if known: {options.IMAGE}."
OPTIONAL = [
    *("certainty.png", "comparison.png", "residual*.png", "stages.png", "space.png", "hidden.glb"),
    *("reconstruction*.npy", "reconstruction*.png", "standard_error*.npy"),
]
"""Files that depend on the scene, the method and the options."""


def reconstruct(
    *,
    photo: options.PhotoArguments,
    session: PhotoSession,
    light: options.LightOptions,
    matrix: options.MatricesOption = None,
    out: options.Out,
    method: options.MethodOption = DEFAULT,
    numbers: options.StillNumbers,
    truth: Annotated[
        list[str] | None, options.option("[ID=]IMAGE", _TRUTH, group=options.OUTPUT)
    ] = None,
    uncertain: Annotated[
        str | None, options.option(_ERRORS, _UNCERTAIN, group=options.SCENE)
    ] = None,
) -> None:
    """Recover the hidden image from one photograph of the wall.

    Of several views it takes one photograph each, with its --camera.
    """
    from periscopy_sim.judgement import check_memory
    from periscopy_sim.methods import find_method, source_sha256

    find_method(method)
    require_all(*libraries_of(photo))
    settings = options.settings_for(method, numbers.values, options.FOR_STILLS)
    text = "" if uncertain in (None, "none") else str(uncertain)
    views = session.views(photo)
    session = next(iter(views.values()))
    matrices = options.by_name("--transport", matrix, views, Path)
    several = len(views) > 1
    if several:
        able = [name for name, entry in METHODS.items() if entry.views]
        if method not in able:
            raise ps.PeriscopyError(
                f"--method {method}: it takes one view; several take {', '.join(able)}"
            )
        _, *others = (view.scenario for view in views.values())
        session.warn_of(check_memory(session.scenario, method, *others))
    errors = options.known_errors(text, session.scenario.document) if text else {}
    counts_errors = method in METHODS and METHODS[method].uncertain
    if errors and not counts_errors:
        raise ps.PeriscopyError(f"--uncertain: {method} does not support it; leave it out")
    light.check_methods(method)
    with output.output_folder(out, OPTIONAL) as folder:
        walls, methods = dict[str, ps.Photograph](), dict[str, "StillMethod[Any]"]()
        for (camera, view), file in zip(views.items(), photo, strict=True):
            view.check_scene(method)
            walls[camera] = view.wall(file)
        names = session.by_surface(truth, "--truth") if truth else None
        known = names and session.scenario.hidden.images(session.scenario.image(names))
        counted = {} if uncertain == "none" else errors or None
        lit = dict[str, ps.Scenario]()
        for camera, view in views.items():
            matrix_file = next(reversed(matrices[camera]), None)  # the last counts
            lit[camera] = view.lit(light, matrix_file)
            methods[camera] = view.fit(method, settings, lit[camera], walls[camera], counted)
        of = ", ".join(map(str, photo))
        with (
            session.timed("reconstruct"),
            output.progress("reconstructing"),
            output.fixable(f"{of} by {method}"),
        ):
            joint: Any = METHODS[method].of_views(methods) if several else methods[session.sensor]
            wall: Any = walls if several else walls[session.sensor]
            solution = joint.solve(wall)
            found = session.scenario.hidden.images(solution.image)
            images = {name: np.asarray(each, np.float64) for name, each in found.items()}
        doing = "residual and standard errors"
        with session.timed(doing), output.progress(f"computing {doing}"):
            whole, reports = joint.report(wall, solution) if several else (None, {})
            verdicts = dict[str, tuple[str, str]]()
            for (camera, view), file in zip(views.items(), photo, strict=True):
                own = joint.of_view(camera, solution) if several else solution
                rest = methods[camera], reports.get(camera)
                reports[camera] = lit[camera].judge(walls[camera], own, *rest)
                verdicts[camera] = view.judge(str(file), reports[camera])
            report = whole or reports[session.sensor]
            for note in whole.warnings if whole else ():
                session.warn(f"{of}: {messages.note_sentence(note)}")
        titles = (f"photograph of {camera}" if several else "photograph" for camera in walls)
        used = (np.moveaxis(wall.planes, 0, -1) for wall in walls.values())
        shown = dict(zip(titles, used, strict=True))
        with session.timed("draw"), output.progress("drawing"):
            write_report(folder, report, session.scenario, images, shown, session.metadata)
            for camera, own in reports.items() if several else ():
                file = folder / f"residual_{camera}.png"
                draw_residual(file, own, walls[camera].values, session.metadata)
        compared = _compare(folder, images, known, shown, session) if known else {}
        hidden, metrics_of = session.scenario.hidden, next(iter(compared.values()), {})
        summary = {
            "method_sha256": source_sha256(method),
            **_of_views(views, photo, verdicts, reports),
            **report.numbers,
            "truth": names and hidden.unwrapped(names),
            **{n: hidden.unwrapped({i: compared[i][n] for i in hidden}) for n in metrics_of},
        }
        session.write_summary(folder / "summary.json", summary)
    for note in chain(*(own.notes for own in reports.values() if several), report.notes):
        output.say(messages.note_sentence(note))
    if reflecting := session.scenario.scene.reflecting:
        output.say(messages.sentence("reflecting", names=", ".join(reflecting)))
    rows = [["method", method], ["time", f"{sum(session.seconds.values()):.1f} s"]]
    rows += messages.comparison(compared) if compared else []
    output.show_table(rows, ["", *compared] if len(compared) > 1 else ())
    for camera, (verdict, colour) in verdicts.items():
        output.conclude(f"{camera}: {verdict}" if several else verdict, colour)


def _of_views(
    views: Mapping[str, PhotoSession],
    photos: Sequence[Path],
    verdicts: Mapping[str, tuple[str, str]],
    reports: "Mapping[str, Report]",
) -> dict[str, Any]:
    """Return the entries of a summary on the views; of several by camera."""
    own: dict[str, dict[str, Any]] = {
        camera: {**view.record, "photograph": str(file), "verdict": verdicts[camera][0]}
        for (camera, view), file in zip(views.items(), photos, strict=True)
    }
    if len(views) == 1:
        return next(iter(own.values()))
    shapes = {camera: view.scenario.photograph_shape for camera, view in views.items()}
    for camera, view in views.items():
        own[camera] |= {"photograph_shape": shapes[camera], **reports[camera].numbers}
        view.record.clear()  # it is no entry of all
    return {"photograph_shape": shapes, "views": own}


def write_report(
    folder: Path,
    report: "Report",
    scenario: ps.Scenario,
    images: Mapping[str, Image],
    photographs: Mapping[str, Array],
    text: dict[str, str],
) -> None:
    """Write images, (R, C, channels), by their surfaces, and what the method reports beside them.

    The photographs are by title, NaN where pixels are not used. The images have one exposure: their
    relative brightness is a result, too.
    """
    hidden, white = scenario.hidden, panels.common_white(images.values())
    lit = {name: panels.displayable(image, white) for name, image in images.items()}
    for name, image in named("reconstruction", images).items():
        np.save(folder / f"{name}.npy", image.astype(np.float32))
    for name, image in named("reconstruction", lit).items():
        panels.write_enlarged(folder / f"{name}.png", image, text)
    if not hidden.is_flat:
        from periscopy_sim.figures.space import draw_space
        from periscopy_sim.storage.glb import write_glb

        wall = panels.displayable(next(iter(photographs.values())))  # of the scenario's view
        draw_space(folder / "space.png", scenario, lit, wall, text)
        write_glb(folder / "hidden.glb", scenario, lit, wall, text)
    if report.stages:
        stages = [(title, hidden.images(stage)) for title, stage in report.stages]
        walls = [(title, panels.exposed(each)) for title, each in photographs.items()]
        shown = {
            name: [*walls, *((title, panels.displayable(stage[name])) for title, stage in stages)]
            for name in hidden
        }
        panels.draw_panels(folder / "stages.png", shown, metadata=text)
    if report.standard_errors is not None:
        errors = hidden.images(report.standard_errors)
        for name, each in named("standard_error", errors).items():
            np.save(folder / f"{name}.npy", each.astype(np.float32))
        counted = messages.assumptions(report.numbers.get("standard_errors_count", ()))
        panels.draw_certainty(folder / "certainty.png", images, errors, counted, text)
    draw_residual(folder / "residual.png", report, next(iter(photographs.values())), text)


def draw_residual(file: Path, report: "Report", photograph: Array, text: dict[str, str]) -> None:
    """Draw the residual beside its photograph, if the report has one."""
    if report.residual is not None:
        panels.draw_residual(file, photograph, report.residual, messages.verdict(report), text)


def _compare(
    folder: Path,
    images: Mapping[str, Image],
    truths: Mapping[str, Image],
    photographs: Mapping[str, Array],
    session: Session,
) -> dict[str, dict[str, Any]]:
    """Return metrics against the truth by surface; draw both beside the photograph."""
    from periscopy_sim.evaluation import metrics

    compared: dict[str, dict[str, Any]] = {}
    rows, lines = {}, []
    walls = [(title, panels.exposed(each)) for title, each in photographs.items()]
    for name, image in images.items():
        truth = truths[name]
        psnr, best = metrics.psnr_gain_matched(image, truth), metrics.registered(image, truth)
        compared[name] = {
            "psnr": psnr,
            "mean_squared_error": metrics.mean_squared_error(image, truth),
            "psnr_registered": best.psnr,
            "psnr_colour_matched": metrics.colour_matched_psnr(image, truth),
            "shift": best.shift,
            "shift_at_limit": best.at_limit,
        }
        rows[name] = [
            ("hidden image", panels.displayable(truth, white=1)),
            *walls,
            ("reconstruction", metrics.gain_matched(image, truth)),
        ]
        of = f"{name}: " if len(images) > 1 else ""
        lines.append(
            f"{of}PSNR {psnr:.1f} dB after one gain per channel that fits the hidden image, "
            f"{best.psnr:.1f} dB after the best shift"
        )
    file = folder / "comparison.png"
    panels.draw_panels(file, rows, caption="\n".join(lines), metadata=session.metadata)
    return compared


OPTIONAL_OF_VIDEO = (
    *("frames*/*.png", "frames*.npy", "frames_sheet.png", "residual.png"),
    *("video.mp4", "video.webm"),
)
"""Files that depend on the scene, the options and the number of frames."""

_TRUTHS = "The hidden images: a folder, an NPY stack, or one image; of several surfaces of each."
_RATE = "Frames a second of the animation."
_ALSO = "A further animation; repeatable."
_FRAMES = "Photographs in time's order: a folder, a Zarr archive, an NPY or NPZ stack."


def video(
    *,
    frames: Annotated[Path, options.argument("FRAMES", _FRAMES, exists=True)],
    session: PhotoSession,
    light: options.LightOptions,
    matrix: options.MatrixOption = None,
    out: options.Out,
    method: options.VideoMethodOption = DEFAULT,
    coupling: options.Coupling = "l1",
    numbers: options.VideoNumbers,
    truth: Annotated[list[str] | None, options.option("[ID=]IMAGES", _TRUTHS)] = None,
    rate: Annotated[
        float, options.option("NUMBER", _RATE, group=options.OUTPUT, kind="rate")
    ] = 16.0,
    also: Annotated[
        list[str] | None, options.option("mp4|webm", _ALSO, group=options.OUTPUT)
    ] = None,
) -> None:
    """Recover a hidden video from photographs of the wall."""
    from periscopy_sim.evaluation import metrics

    for ending in also or ():
        animation.require_encoder(ending)
    formats = ["png", *dict.fromkeys(also or ())]
    settings = options.settings_for(method, numbers.values, options.FOR_VIDEOS, coupling)
    entry = METHODS[method]
    for_still = {each.name: settings.pop(each.name) for each in entry.options}
    light.check_methods(method)
    with output.output_folder(out, OPTIONAL_OF_VIDEO) as folder:
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
        with output.fixable(f"{frames}, first frame"):
            images, records, first = _recover(session, recovery, names, photographs)
            report = scenario.judge(wall, first, still)
            verdict, colour = session.judge(f"{frames}, first frame", report)
        flat = np.concatenate([f.reshape(len(f), -1, f.shape[-1]) for f in images.values()], axis=1)
        metadata, white = session.metadata, animation.white_of(flat)
        walls = np.where(wall.pixels[..., np.newaxis], photographs, np.nan)
        with session.timed("draw"):
            for of, name in named("", {name: name for name in known}).items():
                metrics.compare(records, images[name], known[name], of)
            if known:
                sheet = folder / "frames_sheet.png"
                animation.draw_sheet(sheet, walls, known, images, metadata)
            for stem, stack in named("frames", images).items():
                np.save(folder / f"{stem}.npy", stack)
                with output.progress("drawing the frames") as drawn:
                    animation.draw_frames(folder / stem, stack, white, metadata, drawn)
            for ending in formats:
                with output.progress(f"drawing the animation as {ending}") as drawn:
                    file = folder / f"video.{ending}"
                    animation.draw_video(file, walls, images, known, white, rate, metadata, drawn)
        draw_residual(folder / "residual.png", report, photographs[0], metadata)
        metrics.write_table(folder / "metrics.csv", records)
        medians = metrics.medians_of(records)
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
    output.show_table(rows, ["", *known] if len(known) > 1 else ())
    output.conclude(f"first frame: {verdict}", colour)


def _read(session: PhotoSession, frames: Path) -> tuple[Sequence[str], Image, ps.Photograph]:
    """Return the frames' names, (frames, rows, columns, C) values, and the first one."""
    shape = session.scenario.photograph_shape
    with session.timed("read the frames"), output.progress("reading the photographs") as report:
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

    from periscopy_sim.evaluation import metrics

    images: list[dict[str, Image]] = []
    hidden = session.scenario.hidden
    first: Any = None
    records: list[dict[str, Any]] = []
    # Small products gain little from threads, which wait for each other on a busy machine.
    work = output.progress("reconstructing", "frames")
    with threadpool_limits(1), session.timed("reconstruct"), work as frame_done:
        solved = metrics.timed_solutions(recovery, photographs)
        for k, (solution, seconds) in enumerate(solved):
            images.append(hidden.images(solution.image))
            first = solution if k == 0 else first
            numbers = metrics.record_of(seconds, solution.numbers())
            records.append({"frame": k, "name": names[k], **numbers})
            frame_done(k + 1, len(names))
    stacks = {n: np.stack([each[n] for each in images]).astype(np.float32) for n in hidden}
    return stacks, records, first
