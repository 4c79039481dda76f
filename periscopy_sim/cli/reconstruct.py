"""`periscopy reconstruct`: from a photograph to the hidden image."""

from collections.abc import Mapping, Sequence
from itertools import chain
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import numpy as np

import periscopy_sim as ps
from periscopy_sim.cli import messages, options, output
from periscopy_sim.cli.light import LightOptions
from periscopy_sim.cli.options import OUTPUT, option
from periscopy_sim.cli.session import PhotoSession, Session
from periscopy_sim.extras import require_all
from periscopy_sim.figures import panels
from periscopy_sim.hidden import named
from periscopy_sim.numerics import Array, Image
from periscopy_sim.reconstruction.registry import DEFAULT, METHODS
from periscopy_sim.storage.formats.table import libraries_of

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

if TYPE_CHECKING:
    from periscopy_sim.reconstruction.method import Report, StillMethod


def reconstruct(
    *,
    photo: options.PhotoArguments,
    session: PhotoSession,
    light: LightOptions,
    matrix: options.MatricesOption = None,
    out: options.Out,
    method: options.MethodOption = DEFAULT,
    numbers: options.StillNumbers,
    truth: Annotated[list[str] | None, option("[ID=]IMAGE", _TRUTH, group=OUTPUT)] = None,
    uncertain: Annotated[str | None, option(_ERRORS, _UNCERTAIN, group=options.SCENE)] = None,
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
    matrices = options.files_of_view("--transport", matrix, list(views))
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
