"""`periscopy reconstruct`: from a photograph to the hidden image."""

from __future__ import annotations

from typing import TYPE_CHECKING, Annotated, Any

import numpy as np

import periscopy_sim as ps
from periscopy_sim.cli import options
from periscopy_sim.cli.light import SAMPLES, Light
from periscopy_sim.cli.messages import (
    assumptions,
    residual_summary,
    sentence,
    sentences,
)
from periscopy_sim.cli.method_options import FOR_STILLS, StillMethod, StillNumbers, settings_for
from periscopy_sim.cli.options import SCENE, option
from periscopy_sim.cli.output import as_json, fixable, output_folder, progress, say
from periscopy_sim.cli.session import PhotoSession, Session, pixel_record
from periscopy_sim.errors import PeriscopyError
from periscopy_sim.evaluation import metrics
from periscopy_sim.figures import panels
from periscopy_sim.figures.residual import draw_residual
from periscopy_sim.reconstruction.registry import DEFAULT, METHODS

OPTIONAL = (
    "certainty.png", "comparison.png", "residual.png", "stages.png", "standard_error.npy",
)  # fmt: skip
"""Files that depend on the method and the options."""

NOTHING = "none"
"""Value of --uncertain for a scene without uncertain parameters."""

if TYPE_CHECKING:
    from pathlib import Path

    from periscopy_sim.reconstruction.method import Method
    from periscopy_sim.reconstruction.report import Image, Report
    from periscopy_sim.scenario import Array


def reconstruct(
    *,
    photo: options.PhotoArgument,
    session: PhotoSession,
    light: Light,
    matrix: options.MatrixOption = None,
    out: options.Out,
    method: StillMethod = DEFAULT,
    numbers: StillNumbers,
    truth: Annotated[
        str | None, option("IMAGE", "The hidden image, if known: adds metrics and a picture.")
    ] = None,
    uncertain: Annotated[
        str | None,
        option("NAME[=ERROR],...|none", "Uncertain scene <default>s.", group=SCENE),
    ] = None,
    monitor_off: options.MonitorOffOption = None,
    mask: options.MaskOption = None,
    colour_matrix: options.ColourMatrixOption = None,
) -> None:
    """Recover the hidden image from one photograph of the wall."""
    from periscopy_sim.evaluation.methods import find_method, own_errors, source_sha256
    from periscopy_sim.reconstruction.report import Report

    find_method(method)
    settings = settings_for(method, numbers.values, FOR_STILLS)
    counts_errors = method in METHODS and METHODS[method].uncertain
    named = "" if uncertain in (None, NOTHING) else str(uncertain)
    if named and not counts_errors:
        raise PeriscopyError(f"--uncertain: the method {method} does not support it; leave it out")
    errors = {}
    if named:
        given = options.parse_errors(named, "--uncertain")
        errors = options.known_errors(given, session.path, session.definitions)
    light.check_methods(method)
    colours = None if colour_matrix is None else ps.read_colour_matrix(colour_matrix)
    with output_folder(out, OPTIONAL) as folder:
        session.check_scene(method)
        light = light.resolved(session.scenario, method)
        wall = session.wall(photo, mask, monitor_off, maskable=method in METHODS)
        known = None if truth is None else session.hidden_image(truth)
        moved = None
        if errors:
            moved = _derivatives(session, lambda **how: ps.uncertain_transport(
                session.scenario, errors, samples=light.samples or SAMPLES, **how
            ))  # fmt: skip
        elif counts_errors and uncertain is None:
            moved = _calibrated_transport(session, light.samples or SAMPLES)
        fitted = session.fit(method, settings, light, matrix, wall, moved, colours)
        with (
            session.timed("reconstruct"),
            fixable(f"{photo} by {method}", wall.monitor_off),
            own_errors(method, f"failed on {photo}"),
        ):
            image, solved = _recovered(fitted, wall.values, session.scenario.hidden_shape)
            report = Report() if solved is None else fitted.report(wall.values, solved)
            as_json(report.numbers)
        for line in sentences(report.warnings):
            session.warn(f"{photo}: {line}")
        write_report(folder, report, image, wall.values, session.metadata)
        session.suggest_mask(folder)
        compared = {} if known is None else _compare(folder, image, known, wall.values, session)
        session.write_summary(
            folder / "summary.json",
            {
                "method": method,
                "method_sha256": source_sha256(method),
                "photograph": str(photo),
                **light.origin(matrix),
                **settings,
                **report.numbers,
                **pixel_record(mask, wall.mask, wall.monitor_off),
                "colour_matrix": None if colours is None else colours.matrix,
                "truth": truth,
                **compared,
            },
        )
    if report.residual is not None and not report.warnings:
        say(residual_summary(report.residual))
    for line in sentences(report.notes):
        say(line)
    if compared:
        limit = ", at the limit of the search" if compared["shift_at_limit"] else ""
        say(
            f"against the truth: PSNR {compared['psnr']:.2f} dB, "
            f"{compared['psnr_registered']:.2f} dB after the best shift (patches down, right: "
            f"{compared['shift']}{limit}), {compared['psnr_colour_matched']:.2f} dB after the "
            "matrix of colours that fits the truth best"
        )


def _derivatives(session: Session, render: Any) -> Any:
    """Render the scene's parameter derivatives, with the session's seed."""
    label = "rendering the scene's parameter derivatives"
    with session.timed("uncertain scene"), progress(label) as report:
        return render(seed=session.seed, progress=report)


def _calibrated_transport(session: Session, samples: int) -> ps.UncertainTransport | None:
    """Render derivatives by the parameters that the scene's calibration left uncertain.

    Warn where that calibration does not hold.
    """
    from periscopy_sim.calibration.scene_covariance import scene_covariance

    scenario, scene = session.scenario, session.name
    covariance = scene_covariance(scenario.path)
    if covariance is None:
        return None
    if not covariance.names:
        session.warn(sentence("no_silhouette", scene=scene))
        return None
    changed = ", ".join(covariance.changed(scenario.path, scenario.parameters))
    transport, reason = None, f"{changed} changed since"
    if not changed:
        try:
            transport = _derivatives(session, lambda **how: ps.uncertain_transport(
                scenario, covariance, samples=samples, **how
            ))  # fmt: skip
        except PeriscopyError as error:
            reason = str(error)
    if transport is None:
        session.warn(sentence("uncounted", scene=scene, reason=reason))
    elif not covariance.trusted:
        session.warn(sentence("untrusted", scene=scene))
    return transport


def _recovered(
    method: Method, photograph: Array, hidden_shape: tuple[int, int]
) -> tuple[Array, Any]:
    """Return the image, (R, C, 3), and the solution of a method of the package."""
    from periscopy_sim.evaluation.methods import image_by, promised
    from periscopy_sim.reconstruction.method import StillMethod

    # A user's subclass may override `reconstruct`; then `solve` gives another image.
    if isinstance(method, StillMethod) and type(method).reconstruct is StillMethod.reconstruct:
        solution = method.solve(photograph)
        return promised(solution.image, hidden_shape).astype(np.float64), solution
    return image_by(method, photograph, hidden_shape).astype(np.float64), None


def write_report(
    folder: Path, report: Report, image: Image, photograph: Array, text: dict[str, str]
) -> None:
    """Write the image, (R, C, 3), and what the method reports beside it."""
    np.save(folder / "reconstruction.npy", image.astype(np.float32))
    panels.write_enlarged(folder / "reconstruction.png", panels.displayable(image), text)
    if report.stages:
        stages = [("photograph", photograph), *report.stages]
        shown = [(title, panels.displayable(stage)) for title, stage in stages]
        panels.draw_panels(folder / "stages.png", shown, metadata=text)
    if report.standard_errors is not None:
        np.save(folder / "standard_error.npy", report.standard_errors.astype(np.float32))
        counted = assumptions(report.numbers.get("standard_errors_count", ()))
        file = folder / "certainty.png"
        panels.draw_certainty(file, image, report.standard_errors, counted, text)
    if report.residual is not None:
        caption = residual_summary(report.residual)
        draw_residual(folder / "residual.png", photograph, report.residual, caption, text)


def _compare(
    folder: Path, image: Array, truth: Array, photograph: Array, session: Session
) -> dict[str, Any]:
    """Return metrics against the truth; draw both beside the photograph."""
    psnr, best = metrics.psnr(image, truth), metrics.registered(image, truth)
    panels.draw_panels(
        folder / "comparison.png",
        [
            ("hidden image", panels.displayable(truth, white=1)),
            ("photograph", panels.displayable(photograph)),
            ("reconstruction", metrics.gain_matched(image, truth)),
        ],
        caption=f"PSNR {psnr:.1f} dB after one gain per channel that fits the hidden image, "
        f"{best.psnr:.1f} dB after the best shift, too",
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
