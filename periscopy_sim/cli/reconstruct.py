"""`periscopy reconstruct`: from a photograph to the hidden image."""

from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import numpy as np

import periscopy_sim as ps
from periscopy_sim.calibration.prior import free_parameters
from periscopy_sim.calibration.scene_covariance import scene_covariance
from periscopy_sim.cli import messages, options
from periscopy_sim.cli.light import Light
from periscopy_sim.cli.output import fixable, output_folder, progress, say
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
OPTIONAL = ["certainty.png", "comparison.png", "residual.png", "stages.png", "standard_error.npy"]
"""Files that depend on the method and the options."""

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
    truth: Annotated[
        str | None,
        options.option("IMAGE", f"Hidden image, if known: {options.IMAGE}.", group=options.OUTPUT),
    ] = None,
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
        known = None if truth is None else session.hidden_image(truth)
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
            image = np.asarray(solution.image, np.float64)
        doing = "residual and standard errors"
        with session.timed(doing), progress(f"computing {doing}"):
            report, verdict = session.judge(str(photo), fitted, wall, solution)
        with session.timed("draw"), progress("drawing"):
            write_report(folder, report, image, wall.values, session.metadata)
        compared = {} if known is None else _compare(folder, image, known, wall.values, session)
        summary = {
            "method_sha256": source_sha256(method),
            "photograph": str(photo),
            "verdict": verdict,
            **report.numbers,
            "truth": truth,
            **compared,
        }
        session.write_summary(folder / "summary.json", summary)
    for note in report.notes:
        say(messages.sentence(note.code, **note.values))
    if compared:
        say(messages.comparison(compared))
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
    folder: Path, report: "Report", image: Image, photograph: Array, text: dict[str, str]
) -> None:
    """Write the image, (R, C, channels), and what the method reports beside it."""
    np.save(folder / "reconstruction.npy", image.astype(np.float32))
    panels.write_enlarged(folder / "reconstruction.png", panels.displayable(image), text)
    if report.stages:
        stages = [("photograph", photograph), *report.stages]
        shown = [(title, panels.displayable(stage)) for title, stage in stages]
        panels.draw_panels(folder / "stages.png", shown, metadata=text)
    if report.standard_errors is not None:
        np.save(folder / "standard_error.npy", report.standard_errors.astype(np.float32))
        counted = messages.assumptions(report.numbers.get("standard_errors_count", ()))
        file = folder / "certainty.png"
        panels.draw_certainty(file, image, report.standard_errors, counted, text)
    if report.residual is not None:
        caption = messages.verdict(report)
        panels.draw_residual(folder / "residual.png", photograph, report.residual, caption, text)


def _compare(
    folder: Path, image: Array, truth: Array, photograph: Array, session: Session
) -> dict[str, Any]:
    """Return metrics against the truth; draw both beside the photograph."""
    psnr, best = metrics.psnr_gain_matched(image, truth), metrics.registered(image, truth)
    panels.draw_panels(
        folder / "comparison.png",
        [
            ("hidden image", panels.displayable(truth, white=1)),
            ("photograph", panels.displayable(photograph)),
            ("reconstruction", metrics.gain_matched(image, truth)),
        ],
        caption=f"PSNR {psnr:.1f} dB after one gain per channel that fits the hidden image, "
        f"{best.psnr:.1f} dB after the best shift",
        metadata=session.metadata,
    )
    return {
        "psnr": psnr,
        "mean_squared_error": metrics.mean_squared_error(image, truth),
        "psnr_registered": best.psnr,
        "psnr_colour_matched": metrics.colour_matched_psnr(image, truth),
        "shift": best.shift,
        "shift_at_limit": best.at_limit,
    }
