"""`periscopy reconstruct`: from a photograph to the hidden image."""

from __future__ import annotations

from collections.abc import Mapping
from contextlib import nullcontext
from typing import TYPE_CHECKING, Annotated, Any

import numpy as np

from periscopy_sim.cli import options
from periscopy_sim.cli.inputs import SUGGESTED
from periscopy_sim.cli.light import LightModel, TransportRequest
from periscopy_sim.cli.messages import (
    assumptions,
    residual_summary,
    residual_warning,
    sentences,
)
from periscopy_sim.cli.method_options import FOR_STILLS, method_help, settings_for, takes_options_of
from periscopy_sim.cli.options import SCENE, SOLVER, option
from periscopy_sim.cli.output import as_json, fixable, progress, say, told_folder, warn
from periscopy_sim.cli.session import Session
from periscopy_sim.errors import PeriscopyError
from periscopy_sim.reconstruction.registry import DEFAULT, METHODS
from periscopy_sim.shipped import find_scene

NOTHING = "none"
"""What --uncertain takes for a scene that is to be taken for right."""

if TYPE_CHECKING:
    from pathlib import Path

    from periscopy_sim.model.uncertain_transport import UncertainTransport
    from periscopy_sim.reconstruction.method import Method
    from periscopy_sim.reconstruction.report import Report
    from periscopy_sim.scenario import Array, Scenario


@takes_options_of(FOR_STILLS)
def reconstruct(
    photo: options.PhotoArgument,
    scene: options.SceneOption,
    hidden: options.Hidden,
    out: options.Out,
    method: Annotated[
        str,
        option(
            "NAME",
            f"{method_help(FOR_STILLS)}; yours as module:callable or file.py:callable.",
            group=SOLVER,
            autocompletion=lambda: list(FOR_STILLS),
        ),
    ] = DEFAULT,
    samples: options.Samples = 16,
    model: options.ModelOption = options.Model.rendered,
    bounces: options.BouncesOption = "direct",
    matrix: options.MatrixOption = None,
    truth: Annotated[
        str | None,
        option(
            "IMAGE",
            "The hidden image, if known (a file or a shipped one): adds metrics, a picture.",
        ),
    ] = None,
    uncertain: Annotated[
        str | None,
        option(
            "NAME[=ERROR],...",
            "Scene <default>s that may be wrong, such as occluder_dx,occluder_dz=0.005, in which "
            "the standard errors count. Default: what a calibrated scene carries; none: nothing.",
            group=SCENE,
        ),
    ] = None,
    monitor_off: options.MonitorOffOption = None,
    light_model: options.LightModelOption = None,
    mask: options.MaskOption = None,
    seed: options.Seed = 0,
    define: options.Define = None,
    **numbers: float | None,
) -> None:
    """Recover the hidden image from one photograph of the wall."""
    from periscopy_sim.evaluation.methods import find_method, own_errors, source_sha256
    from periscopy_sim.figures import panels
    from periscopy_sim.reconstruction.report import Report

    find_method(method)
    settings = settings_for(method, numbers, FOR_STILLS)
    session = Session(scene, hidden, define, seed)
    doubted = _uncertain_errors(uncertain, method, scene, session.definitions)
    request = TransportRequest(samples, seed, model, options.parse_bounces(bounces), matrix)
    lights = LightModel.of(light_model, seed, [method])
    with told_folder(out) as folder:
        session.check_scene(method)
        scenario, timed = session.scenario, session.timed
        wall = session.wall(
            photo, mask, monitor_off, suggested=out / SUGGESTED, maskable=method in METHODS
        )
        known = None if truth is None else session.hidden_image(truth)
        with timed("uncertain scene") if doubted or uncertain else nullcontext():
            moved, untold = _uncertain_transport(
                doubted, uncertain, method, scenario, scene, samples, seed
            )
        session.warnings += untold
        fitted, _ = session.fit(method, settings, request, lights, wall, moved)
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
        warning = residual_warning(report.residual)
        warnings = [*sentences(report.warnings), *filter(None, [warning])]
        _write_report(folder, report, image, wall.values, text)
        np.save(folder / "reconstruction.npy", image.astype(np.float32))
        wall.defects.suggest_mask(folder, text)
        panels.write_enlarged(folder / "reconstruction.png", panels.displayable(image), text)
        compared = None if known is None else _compare(folder, image, known, wall.values, text)
        session.warnings += warnings
        session.write_summary(
            folder / "summary.json",
            {
                "method": method,
                "method_sha256": source_sha256(method),
                "photograph": str(photo),
                **request.origin,
                **lights.origin,
                **settings,
                **report.numbers,
                **wall.record,
                "truth": truth,
                **(compared or {}),
            },
        )
    for line in warnings:
        warn(f"{photo}: {line}")
    if report.residual is not None:
        say(residual_summary(report.residual))
    for line in sentences(report.notes):
        say(line)
    if compared:
        limit = ", at the limit of the search" if compared["shift_at_limit"] else ""
        say(
            f"against the truth: gain-matched PSNR {compared['psnr']:.2f} dB, registered "
            f"{compared['psnr_registered']:.2f} dB (shift {compared['shift']} patches down, right"
            f"{limit})"
        )


def _uncertain_errors(
    text: str | None, method: str, scene: str, given: Mapping[str, str]
) -> dict[str, float]:
    """Read and check ``--uncertain``, before anything is rendered; empty where there are none."""
    if text is None or text == NOTHING:
        return {}
    if method not in METHODS or not METHODS[method].uncertain:
        able = " or ".join(name for name, entry in METHODS.items() if entry.uncertain)
        raise PeriscopyError(
            f"--uncertain belongs to --method {able}, not to {method}; leave it out"
        )
    named = options.parse_errors(text, "--uncertain")
    if not named:
        raise PeriscopyError(f"--uncertain '{text}' names nothing; write NAME=ERROR, or {NOTHING}")
    return options.known_errors(named, find_scene(scene), given)


def _uncertain_transport(
    errors: Mapping[str, float],
    asked: str | None,
    method: str,
    scenario: Scenario,
    scene: str,
    samples: int,
    seed: int,
) -> tuple[UncertainTransport | None, list[str]]:
    """Render derivatives by uncertain parameters, as asked or as a calibrated scene carries them.

    The warnings, a line each, say that what the scene carries does not hold.
    """
    from periscopy_sim.calibration.scene_covariance import scene_covariance
    from periscopy_sim.calibration.uncertain_scene import calibrated_transport, uncertain_transport

    label = "rendering the scene's parameter derivatives"
    if errors:
        with progress(label) as report:
            found = uncertain_transport(
                scenario, errors, samples=samples, seed=seed, progress=report
            )
        return found, []
    able = method in METHODS and METHODS[method].uncertain
    known = scene_covariance(scenario.path) if asked is None and able else None
    if known is None:
        return None, []
    if not known.names:
        distrust = f"{scene}: its silhouette did not converge, so the image is unreliable"
        warn(distrust)
        return None, [distrust]
    warnings, carried = [], None
    changed = known.changed(scenario.path, scenario.parameters)
    if changed:
        why = f"{', '.join(changed)} is not as it was calibrated"
    else:
        try:
            with progress(label) as report:
                carried = calibrated_transport(
                    scenario, known, samples=samples, seed=seed, progress=report
                )
            why = "which the photograph does not show"
        except PeriscopyError as error:
            why = str(error)
    if carried is None:
        warnings.append(
            f"{scene}: the standard errors leave out what its calibration left uncertain ({why}); "
            "tell how uncertain it is by --uncertain"
        )
    elif not known.trusted:
        warnings.append(
            f"{scene}: its calibration is not to be trusted, so neither are the image's place and "
            "its standard errors"
        )
    for warning in warnings:
        warn(warning)
    return carried, warnings


def _recovered(
    method: Method, photograph: Array, hidden_shape: tuple[int, int]
) -> tuple[Array, Any]:
    """Reconstruct, once; of a method of the package, keep its solution, which tells more."""
    from periscopy_sim.evaluation.methods import promised
    from periscopy_sim.reconstruction.method import StillMethod

    # What a user derives from a method and reconstructs otherwise tells of another image.
    if isinstance(method, StillMethod) and type(method).reconstruct is StillMethod.reconstruct:
        found = method.solve(photograph)
        return promised(found.image, hidden_shape).astype(np.float64), found
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
        f"{best.psnr:.1f} dB where a shift may, too",
        metadata=text,
    )
    return {
        "psnr": psnr,
        "mean_squared_error": metrics.mean_squared_error(image, truth),
        "psnr_registered": best.psnr,
        "shift": best.shift,
        "shift_at_limit": best.at_limit,
    }
