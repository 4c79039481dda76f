"""`periscopy reconstruct`: from a photograph to the hidden image."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from contextlib import nullcontext
from dataclasses import dataclass, field, replace
from typing import TYPE_CHECKING, Annotated, Any

import numpy as np

from periscopy_sim.cli import arguments, inputs
from periscopy_sim.cli.arguments import option, parse_definitions
from periscopy_sim.cli.fitting.fit import fit
from periscopy_sim.cli.fitting.prototypes import AskedPrototypes, PrototypesOption
from periscopy_sim.cli.fitting.transport_matrix import (
    AskedTransport,
    BouncesOption,
    Model,
    ModelOption,
    parse_bounces,
)
from periscopy_sim.cli.method_options import FOR_STILLS, method_help, settings_for, takes_options_of
from periscopy_sim.cli.output import (
    Stopwatch,
    as_json,
    fixable,
    progress,
    say,
    told_folder,
    warn,
    write_json,
)
from periscopy_sim.errors import PeriscopyError
from periscopy_sim.reconstruction.registry import DEFAULT, METHODS
from periscopy_sim.shipped import find_scene
from periscopy_sim.storage.outputs.provenance import as_text

NOTHING = "none"
"""What --uncertain takes for a scene that is to be taken for right."""

if TYPE_CHECKING:
    from pathlib import Path

    from periscopy_sim.model.residual import Residual
    from periscopy_sim.model.uncertain_transport import UncertainTransport
    from periscopy_sim.reconstruction.method import Method
    from periscopy_sim.scenario import Array, Scenario


@takes_options_of(FOR_STILLS)
def reconstruct(
    photo: arguments.PhotoArgument,
    scene: arguments.SceneOption,
    hidden: arguments.Hidden,
    out: arguments.Out,
    method: Annotated[
        str,
        option(
            "NAME",
            f"{method_help(FOR_STILLS)}; yours as module:callable or file.py:callable.",
            autocompletion=lambda: list(FOR_STILLS),
        ),
    ] = DEFAULT,
    samples: arguments.Samples = 16,
    model: ModelOption = Model.rendered,
    bounces: BouncesOption = "direct",
    matrix: arguments.MatrixOption = None,
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
            "Scene <default>s that may be wrong, such as occluder_dx,occluder_dz=0.005: the image "
            "is that of the scene which they make most probable, its standard errors count theirs. "
            "Without ERROR, that of the <default> NAME_error. Default: what a calibrated scene "
            "carries, in the standard errors alone; none: nothing.",
        ),
    ] = None,
    background: arguments.BackgroundOption = None,
    backgrounds: PrototypesOption = None,
    mask: arguments.MaskOption = None,
    seed: arguments.Seed = 0,
    define: arguments.Define = None,
    **options: float | None,
) -> None:
    """Recover the hidden image from one photograph of the wall."""
    from periscopy_sim.evaluation.methods import check_able, find_method, own_errors, source_sha256
    from periscopy_sim.figures import panels
    from periscopy_sim.figures.residual import draw_residual
    from periscopy_sim.photographs.checking import blackened

    find_method(method)
    settings = settings_for(method, options, FOR_STILLS)
    doubted = _uncertain_errors(uncertain, method, scene, parse_definitions(define))
    asked = AskedTransport(samples, seed, model, parse_bounces(bounces), matrix)
    prototypes = AskedPrototypes.of(backgrounds, seed, [method])
    timed = Stopwatch()
    with told_folder(out) as folder:
        with timed("load the scene"), progress("loading the scene"):
            scenario = inputs.load(scene, hidden, define)
        check_able(method, scenario.hidden_shape)
        unseen = inputs.warn_without_shadows(scenario, scene)
        unseen += inputs.warn_of_long_patches(scenario, scene)
        used = inputs.read_mask(mask, scenario)
        given = inputs.read_photograph(photo, scenario, used)
        dark = inputs.read_backgrounds(background, scenario, used)
        defects = inputs.look_for_defects(
            given.values, used, str(photo), out / inputs.SUGGESTED, maskable=method in METHODS
        )
        used = defects.used
        seen = blackened(given.values, used)
        known = None if truth is None else inputs.hidden_image(truth, scenario.hidden_shape)
        with timed("uncertain scene") if doubted or uncertain else nullcontext():
            moved, untold = _uncertain_transport(
                doubted, uncertain, method, scenario, scene, samples, seed,
                linear=not asked.is_rendered,
            )  # fmt: skip
        fitted, A = fit(method, settings, scenario, used, dark, timed, asked, prototypes, moved)
        provenance = inputs.provenance_of(scenario, seed)
        text = as_text(provenance)
        with (
            timed("reconstruct"),
            fixable(f"{photo} by {method}", dark),
            own_errors(method, f"failed on {photo}"),
        ):
            image, solved = _recovered(fitted, seen, scenario.hidden_shape)
        with own_errors(method, f"failed on {photo}"):
            told = _told(fitted, seen, solved, scenario, defects)
            left = told.residual
            explicable = left and left.likeliest not in ("", "object")
            otherwise = left and (left.better_orientation or left.better_encoding)
            if left and explicable and not (dark or told.doubt or otherwise):
                told = replace(told, doubt=_doubt(scenario, A, used, seen))
        doubts = list(filter(None, (told.doubt, told.misfit)))
        _write_told(folder, told, image, seen, text)
        if told.residual is not None:
            draw_residual(folder / "residual.png", seen, told.residual, text)
        np.save(folder / "reconstruction.npy", image.astype(np.float32))
        defects.suggest_mask(folder, text)
        shown = panels.displayable(image)
        panels.write_enlarged(folder / "reconstruction.png", shown, text)
        summary: dict[str, Any] = {
            "method": method,
            "method_sha256": source_sha256(method),
            "photograph": str(photo),
            "photograph_shape": scenario.photograph_shape,
            "hidden_shape": scenario.hidden_shape,
            **asked.origin,
            **prototypes.origin,
            **settings,
            **told.numbers,
            **inputs.mask_record(mask, used),
            "backgrounds": list(dark),
            "warnings": [*unseen, *untold, *given.warnings, *defects.warnings, *doubts],
            "truth": truth,
        }
        if known is not None:
            summary |= _compare(folder, image, known, seen, text)
        write_json(
            folder / "summary.json", {**summary, "seconds": timed.seconds, "provenance": provenance}
        )
    for doubt in doubts:
        warn(f"{photo}: {doubt}")
    for remark in told.remarks:
        say(remark)
    if known is not None:
        farther = ": none farther is tried, so the image may be farther off"
        say(
            f"against the truth: gain-matched PSNR {summary['psnr']:.2f} dB, registered "
            f"{summary['psnr_registered']:.2f} dB (shift {summary['shift']} patches down, right"
            f"{farther if summary['shift_at_limit'] else ''})"
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
    named = arguments.parse_errors(text, "--uncertain")
    if not named:
        raise PeriscopyError(f"--uncertain '{text}' names nothing; write NAME=ERROR, or {NOTHING}")
    return arguments.known_errors(named, find_scene(scene), given)


def _uncertain_transport(
    errors: Mapping[str, float],
    asked: str | None,
    method: str,
    scenario: Scenario,
    scene: str,
    samples: int,
    seed: int,
    *,
    linear: bool,
) -> tuple[UncertainTransport | None, list[str]]:
    """Render what errors of parameters do, as asked or as a calibrated scene carries them.

    Also returned is, a line each, what a user is warned of: that what is carried does not hold.
    """
    from periscopy_sim.calibration.scene_covariance import scene_covariance
    from periscopy_sim.calibration.uncertain_scene import calibrated_transport, uncertain_transport

    label = "rendering what errors of the scene do"
    if errors:
        with progress(label) as report:
            found = uncertain_transport(
                scenario, errors, samples=samples, seed=seed, linear=linear, progress=report
            )
        return found, []
    able = method in METHODS and METHODS[method].uncertain
    known = scene_covariance(scenario.path) if asked is None and able else None
    if known is None:
        return None, []
    if not known.names:
        distrust = f"{scene}: its silhouette is not to be trusted, so neither is the image"
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
            "its standard errors, though they count what the calibration left uncertain"
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


@dataclass(frozen=True, eq=False)
class _Told:
    """What a method knows beside the image: pictures (R, C, 3), doubts, what a summary keeps."""

    stages: Sequence[tuple[str, Array]] = ()
    standard_errors: Array | None = None
    residual: Residual | None = None
    remarks: Sequence[str] = ()
    doubt: str = ""
    misfit: str = ""
    numbers: Mapping[str, Any] = field(default_factory=dict)


def _told(
    method: Any,
    photograph: Array,
    found: Any,
    scenario: Scenario,
    defects: inputs.Defects,
) -> _Told:
    """Ask a method of a solution, and hold it to what `StillMethod` promises; ValueError if not."""
    from periscopy_sim.calibration.scene_covariance import is_calibrated
    from periscopy_sim.evaluation.methods import promised
    from periscopy_sim.figures.panels import displayable

    if found is None:
        return _Told()
    shape = scenario.hidden_shape
    errors = method.standard_errors(found)
    stages = list(method.stages(found))
    for _, image in stages:
        promised(image, shape)
    residual = method.residual(photograph, found)
    if residual and residual.causes:
        residual = replace(residual, is_calibrated=is_calibrated(scenario))
    numbers = {**method.told(found), **(residual.told() if residual else {})}
    as_json(numbers)
    remarks = residual.remark if residual else "", str(method.remark(found))
    return _Told(
        [(str(title), displayable(image)) for title, image in stages],
        None if errors is None else np.reshape(errors, (*shape, 3)).astype(np.float64),
        residual,
        tuple(filter(None, remarks)),
        str(method.doubt(found)),
        defects.else_warned(residual),
        numbers,
    )


def _doubt(scenario: Scenario, A: Any, mask: inputs.Mask | None, seen: Array) -> str:
    """Return why a photograph may show no monitor, though the scene does not explain it."""
    from periscopy_sim.analytic.point_light import point_light_backgrounds
    from periscopy_sim.model.ambient import background_basis
    from periscopy_sim.model.observation import observation_of
    from periscopy_sim.reconstruction.monitor_left_on import monitor_doubt

    sizes = scenario.hidden_shape, scenario.channel_gain, mask, scenario.photograph_shape
    observed = observation_of(A, *sizes)
    smooth = background_basis(observed.used(point_light_backgrounds(scenario)))
    return monitor_doubt(A, smooth, observed, seen)


def _write_told(
    folder: Path, told: _Told, image: Array, photograph: Array, text: dict[str, str]
) -> None:
    """Draw the stages and the standard errors, where there are any."""
    from periscopy_sim.figures import panels

    if told.stages:
        shown = [("photograph", panels.displayable(photograph)), *told.stages]
        panels.draw_panels(folder / "stages.png", shown, metadata=text)
    if told.standard_errors is not None:
        np.save(folder / "standard_error.npy", told.standard_errors.astype(np.float32))
        panels.draw_certainty(
            folder / "certainty.png",
            image,
            told.standard_errors,
            told.numbers.get("standard_errors_assume", ""),
            text,
        )


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
