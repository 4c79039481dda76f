"""`periscopy reconstruct`: from a photograph to the hidden image."""

from __future__ import annotations

from collections.abc import Mapping
from typing import TYPE_CHECKING, Annotated, Any

import numpy as np

from periscopy_sim.cli import options
from periscopy_sim.cli.light import SAMPLES, LightModel, TransportRequest
from periscopy_sim.cli.messages import (
    assumptions,
    residual_summary,
    sentences,
)
from periscopy_sim.cli.method_options import FOR_STILLS, StillMethod, settings_for, takes_options_of
from periscopy_sim.cli.options import SCENE, option
from periscopy_sim.cli.output import as_json, fixable, output_folder, progress, say
from periscopy_sim.cli.session import SUGGESTED, Session, pixel_record
from periscopy_sim.errors import PeriscopyError
from periscopy_sim.reconstruction.registry import DEFAULT, METHODS
from periscopy_sim.shipped import find_scene

OPTIONAL = (
    "certainty.png", "comparison.png", "residual.png", "stages.png", "standard_error.npy",
)  # fmt: skip
"""Files that depend on the method and the options."""

NOTHING = "none"
"""Value of --uncertain for a scene without uncertain parameters."""

DERIVATIVES = "rendering the scene's parameter derivatives"

if TYPE_CHECKING:
    from pathlib import Path

    from periscopy_sim.model.uncertain_transport import UncertainTransport
    from periscopy_sim.reconstruction.method import Method
    from periscopy_sim.reconstruction.report import Report
    from periscopy_sim.scenario import Array


@takes_options_of(FOR_STILLS)
def reconstruct(
    photo: options.PhotoArgument,
    scene: options.SceneOption,
    hidden: options.Hidden,
    out: options.Out,
    method: StillMethod = DEFAULT,
    samples: options.RaysOption = None,
    model: options.ClosedOption = None,
    bounces: options.BouncesOption = "direct",
    matrix: options.MatrixOption = None,
    truth: Annotated[
        str | None, option("IMAGE", "The hidden image, if known: adds metrics and a picture.")
    ] = None,
    uncertain: Annotated[
        str | None,
        option("NAME[=ERROR],...|none", "Uncertain scene <default>s.", group=SCENE),
    ] = None,
    monitor_off: options.MonitorOffOption = None,
    light_model: options.LightModelOption = None,
    mask: options.MaskOption = None,
    colour_matrix: options.ColourMatrixOption = None,
    seed: options.Seed = 0,
    define: options.Define = None,
    **numbers: float | None,
) -> None:
    """Recover the hidden image from one photograph of the wall."""
    from periscopy_sim.evaluation.methods import find_method, own_errors, source_sha256
    from periscopy_sim.figures import panels
    from periscopy_sim.reconstruction.report import Report
    from periscopy_sim.storage.colour_matrix import read_colour_matrix

    find_method(method)
    settings = settings_for(method, numbers, FOR_STILLS)
    session = Session(scene, hidden, define, seed)
    errors = _uncertain_errors(uncertain, method, scene, session.definitions)
    request = TransportRequest(
        samples, seed, model, options.parse_bounces(bounces), matrix, method=method
    )
    lights = LightModel.of(light_model, seed, [method])
    colours = None if colour_matrix is None else read_colour_matrix(colour_matrix)
    with output_folder(out, OPTIONAL) as folder:
        session.check_scene(method)
        scenario, timed = session.scenario, session.timed
        wall = session.wall(
            photo, mask, monitor_off, suggested=out / SUGGESTED, maskable=method in METHODS
        )
        known = None if truth is None else session.hidden_image(truth)
        moved = None
        if errors:
            moved = _uncertain_transport(session, errors, samples or SAMPLES)
        elif uncertain is None and _has_errors(method):
            moved = _calibrated_transport(session, samples or SAMPLES)
        fitted = session.fit(method, settings, request, lights, wall, moved, colours)
        text = session.metadata
        with (
            timed("reconstruct"),
            fixable(f"{photo} by {method}", wall.monitor_off),
            own_errors(method, f"failed on {photo}"),
        ):
            image, solved = _recovered(fitted, wall.values, scenario.hidden_shape)
        with own_errors(method, f"failed on {photo}"):
            report = Report() if solved is None else fitted.report(wall.values, solved)
            as_json(report.numbers)
        _write_report(folder, report, image, wall.values, text)
        np.save(folder / "reconstruction.npy", image.astype(np.float32))
        session.suggest_mask(folder)
        panels.write_enlarged(folder / "reconstruction.png", panels.displayable(image), text)
        compared = None if known is None else _compare(folder, image, known, wall.values, text)
        for line in sentences(report.warnings):
            session.warn(f"{photo}: {line}")
        session.write_summary(
            folder / "summary.json",
            {
                "method": method,
                "method_sha256": source_sha256(method),
                "photograph": str(photo),
                **request.origin(scenario),
                **lights.origin,
                **settings,
                **report.numbers,
                **pixel_record(mask, wall.mask, wall.monitor_off),
                "colour_matrix": None if colours is None else colours.matrix,
                "truth": truth,
                **(compared or {}),
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


def _uncertain_errors(
    text: str | None, method: str, scene: str, given: Mapping[str, str]
) -> dict[str, float]:
    """Read ``--uncertain``, before anything is rendered; empty without errors."""
    if text is None or text == NOTHING:
        return {}
    if not _has_errors(method):
        able = " or ".join(name for name in METHODS if _has_errors(name))
        raise PeriscopyError(
            f"--uncertain belongs to --method {able}, not to {method}; leave it out"
        )
    named = options.parse_errors(text, "--uncertain")
    if not named:
        raise PeriscopyError(f"--uncertain '{text}' names nothing; write NAME=ERROR, or {NOTHING}")
    return options.known_errors(named, find_scene(scene), given)


def _has_errors(method: str) -> bool:
    """Return whether a method's standard errors may count uncertain parameters."""
    return method in METHODS and METHODS[method].uncertain


def _uncertain_transport(
    session: Session, errors: Mapping[str, float], samples: int
) -> UncertainTransport | None:
    """Render derivatives by the parameters of ``--uncertain``, with their errors."""
    from periscopy_sim.calibration.uncertain_scene import uncertain_transport

    with session.timed("uncertain scene"), progress(DERIVATIVES) as report:
        return uncertain_transport(
            session.scenario, errors, samples=samples, seed=session.seed, progress=report
        )


def _calibrated_transport(session: Session, samples: int) -> UncertainTransport | None:
    """Render derivatives by the parameters that the scene's calibration left uncertain.

    Warn where that calibration does not hold.
    """
    from periscopy_sim.calibration.scene_covariance import scene_covariance

    scenario, scene = session.scenario, session.name
    covariance = scene_covariance(scenario.path)
    if covariance is None:
        return None
    if not covariance.names:
        session.warn(f"{scene}: its silhouette did not converge, so the image is unreliable")
        return None
    changed = ", ".join(covariance.changed(scenario.path, scenario.parameters))
    transport, reason = None, f"{changed} changed since" if changed else "no effect on A"
    if not changed:
        from periscopy_sim.calibration.uncertain_scene import calibrated_transport

        try:
            with session.timed("uncertain scene"), progress(DERIVATIVES) as report:
                transport = calibrated_transport(
                    scenario, covariance, samples=samples, seed=session.seed, progress=report
                )
        except PeriscopyError as error:
            reason = str(error)
    if transport is None:
        session.warn(
            f"{scene}: the standard errors ignore the calibration's ({reason}); pass --uncertain"
        )
    elif not covariance.trusted:
        session.warn(
            f"{scene}: its calibration is unreliable, and so are the image's place and its "
            "standard errors"
        )
    return transport


def _recovered(
    method: Method, photograph: Array, hidden_shape: tuple[int, int]
) -> tuple[Array, Any]:
    """Return the image, (R, C, 3), and the solution of a method of the package."""
    from periscopy_sim.evaluation.methods import promised
    from periscopy_sim.reconstruction.method import StillMethod

    # A user's subclass may override `reconstruct`; then `solve` gives another image.
    if isinstance(method, StillMethod) and type(method).reconstruct is StillMethod.reconstruct:
        solution = method.solve(photograph)
        return promised(solution.image, hidden_shape).astype(np.float64), solution
    return promised(method.reconstruct(photograph), hidden_shape).astype(np.float64), None


def _write_report(
    folder: Path, report: Report, image: Array, photograph: Array, text: dict[str, str]
) -> None:
    """Draw the stages, the standard errors and the residual, where there are any."""
    from periscopy_sim.figures import panels
    from periscopy_sim.figures.residual import draw_residual

    if report.stages:
        stages = [(title, panels.displayable(stage)) for title, stage in report.stages]
        shown = [("photograph", panels.displayable(photograph)), *stages]
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
    folder: Path, image: Array, truth: Array, photograph: Array, text: dict[str, str]
) -> dict[str, Any]:
    """Metrics against the truth, and the picture of both beside the photograph."""
    from periscopy_sim.evaluation import metrics
    from periscopy_sim.figures import panels

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
        metadata=text,
    )
    return {
        "psnr": psnr,
        "mean_squared_error": metrics.mean_squared_error(image, truth),
        "psnr_registered": best.psnr,
        "psnr_colour_matched": metrics.colour_matched_psnr(image, truth),
        "shift": best.shift,
        "shift_at_limit": best.at_limit,
    }
