"""`periscopy reconstruct`: from a photograph to the hidden image."""

from collections.abc import Mapping
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import numpy as np

import periscopy_sim as ps
from periscopy_sim.calibration.prior import free_parameters
from periscopy_sim.calibration.scene_covariance import scene_covariance
from periscopy_sim.cli import messages, options
from periscopy_sim.cli.light import Light
from periscopy_sim.cli.options import OUTPUT
from periscopy_sim.cli.output import by_file, fixable, output_folder, progress, say
from periscopy_sim.cli.session import PhotoSession, Session
from periscopy_sim.errors import PeriscopyError
from periscopy_sim.evaluation import metrics
from periscopy_sim.figures import panels
from periscopy_sim.numerics import Array, Image
from periscopy_sim.reconstruction.registry import DEFAULT, METHODS

_UNCERTAIN = (
    "Uncertain <default>s with their standard errors; without =ERROR, the scene's. none: trust all "
    "values. [default: all that have a declared or calibrated error]"
)
_TRUTH = f"Hidden image, if known: {options.IMAGE}."
OPTIONAL = [
    *("certainty.png", "comparison.png", "residual.png", "stages.png"),
    *("reconstruction*.npy", "reconstruction*.png", "standard_error*.npy"),
]
"""Files that depend on the scene, the method and the options."""

if TYPE_CHECKING:
    from periscopy_sim.reconstruction.method import Report


def reconstruct(
    *,
    photo: options.PhotoArgument,
    session: PhotoSession,
    light: Light,
    matrix: options.MatrixOption = None,
    out: options.Out,
    method: options.MethodOption = DEFAULT,
    numbers: options.StillNumbers,
    truth: Annotated[list[str] | None, options.option("[ID=]IMAGE", _TRUTH, group=OUTPUT)] = None,
    uncertain: Annotated[
        str | None, options.option("NAME[=ERROR],...|none", _UNCERTAIN, group=options.SCENE)
    ] = None,
) -> None:
    """Recover the hidden image from one photograph of the wall."""
    from periscopy_sim.evaluation.methods import find_method, own_errors, source_sha256

    find_method(method)
    settings = options.settings_for(method, numbers.values, options.FOR_STILLS)
    text = "" if uncertain in (None, "none") else str(uncertain)
    named = options.known_errors(text, session.scenario.document) if text else {}
    counts_errors = method in METHODS and METHODS[method].uncertain
    if named and not counts_errors:
        raise PeriscopyError(f"--uncertain: the method {method} does not support it; leave it out")
    light.check_methods(method)
    with output_folder(out, OPTIONAL) as folder:
        session.check_scene(method)
        wall = session.wall(photo)
        names = session.by_surface(truth, "--truth") if truth else None
        known = names and session.scenario.hidden.images(session.hidden_image(names))
        counts = counts_errors and uncertain != "none"
        moved = _uncertain_light(session, named) if counts else None
        fitted = session.fit(method, settings, light, matrix, wall, moved)
        with (
            session.timed("reconstruct"),
            progress("reconstructing"),
            fixable(f"{photo} by {method}"),
            own_errors(method, f"failed on {photo}"),
        ):
            solution = fitted.solve(wall)
            found = session.scenario.hidden.images(solution.image)
            images = {name: np.asarray(each, np.float64) for name, each in found.items()}
        doing = "residual and standard errors"
        with session.timed(doing), progress(f"computing {doing}"):
            report, verdict = session.judge(str(photo), fitted, wall, solution)
        with session.timed("draw"), progress("drawing"):
            write_report(folder, report, images, wall.values, session.metadata)
        compared = _compare(folder, images, known, wall.values, session) if known else {}
        summary = {
            "method_sha256": source_sha256(method),
            "photograph": str(photo),
            "verdict": verdict,
            **report.numbers,
            "truth": names and session.scenario.hidden.unwrapped(names),
            **session.by_metric(compared),
        }
        session.write_summary(folder / "summary.json", summary)
    for note in report.notes:
        say(messages.sentence(note.code, **note.values))
    for name, each in compared.items():
        say(messages.comparison(each, name if len(compared) > 1 else ""))
    say(verdict)


def _uncertain_light(session: Session, named: dict[str, float]) -> "ps.UncertainTransport | None":
    """Return what errors do to light: those named, else a calibration's, else the declared ones."""
    from periscopy_sim.analytic.area_transport import has_areas

    scenario, scene = session.scenario, session.scene
    known = None if named else scene_covariance(scenario.document)
    if known and not known.trusted:
        session.warn(messages.sentence("untrusted", scene=scene))
    if known and (changed := ", ".join(known.changed(scenario.document))):
        session.warn(messages.sentence("uncounted", scene=scene, names=changed))
        return None
    errors = known or named or free_parameters(scenario.document)
    if not (known.names if known else errors):
        return None
    if named or has_areas(scenario):
        return ps.uncertain_transport(scenario, errors)
    say(messages.sentence("no_derivatives", scene=scene))
    return None


def write_report(
    folder: Path,
    report: "Report",
    images: Mapping[str, Image],
    photograph: Array,
    text: dict[str, str],
) -> None:
    """Write images, (R, C, channels), by their surfaces, and what the method reports beside them.

    They have one exposure: their relative brightness is a result, too.
    """
    hidden = ps.Hidden.of({name: image.shape[:2] for name, image in images.items()})
    white, wall = panels.common_white(images.values()), panels.displayable(photograph)
    for name, image in by_file("reconstruction", images).items():
        np.save(folder / f"{name}.npy", image.astype(np.float32))
        panels.write_enlarged(folder / f"{name}.png", panels.displayable(image, white), text)
    if report.stages:
        stages = [(title, hidden.images(stage)) for title, stage in report.stages]
        rows = {
            name: [(title, panels.displayable(stage[name])) for title, stage in stages]
            for name in hidden
        }
        shown = {name: [("photograph", wall), *row] for name, row in rows.items()}
        panels.draw_panels(folder / "stages.png", shown, metadata=text)
    if report.standard_errors is not None:
        errors = hidden.images(report.standard_errors)
        for name, each in by_file("standard_error", errors).items():
            np.save(folder / f"{name}.npy", each.astype(np.float32))
        counted = messages.assumptions(report.numbers.get("standard_errors_count", ()))
        panels.draw_certainty(folder / "certainty.png", images, errors, counted, text)
    if report.residual is not None:
        caption = messages.verdict(report)
        panels.draw_residual(folder / "residual.png", photograph, report.residual, caption, text)


def _compare(
    folder: Path,
    images: Mapping[str, Image],
    truths: Mapping[str, Image],
    photograph: Array,
    session: Session,
) -> dict[str, dict[str, Any]]:
    """Return metrics against the truth by surface; draw both beside the photograph."""
    compared: dict[str, dict[str, Any]] = {}
    rows, lines, wall = {}, [], panels.displayable(photograph)
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
            ("photograph", wall),
            ("reconstruction", metrics.gain_matched(image, truth)),
        ]
        lines.append(
            f"PSNR {psnr:.1f} dB after one gain per channel that fits the hidden image, "
            f"{best.psnr:.1f} dB after the best shift"
        )
    if len(lines) > 1:
        lines = [f"{name}: {line}" for name, line in zip(rows, lines, strict=True)]
    file = folder / "comparison.png"
    panels.draw_panels(file, rows, caption="\n".join(lines), metadata=session.metadata)
    return compared
