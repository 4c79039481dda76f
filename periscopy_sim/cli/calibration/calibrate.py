"""`periscopy calibrate`: the parameters of a scene, from the photograph alone."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

from periscopy_sim.cli import options as arguments
from periscopy_sim.cli.calibration.report import say_found, told
from periscopy_sim.cli.calibration.silhouette import find_silhouette, refuse_others
from periscopy_sim.cli.options import option, parse_size
from periscopy_sim.cli.output import (
    progress,
    say_written,
    warn_boxed,
    write_json,
)
from periscopy_sim.cli.session import Session, pixel_record
from periscopy_sim.errors import SceneError
from periscopy_sim.storage.outputs.staging import spare_inputs, staged_file

if TYPE_CHECKING:
    from periscopy_sim.calibration.result import Calibration


DISTRUSTED = (
    "Look at the picture, and at what stays unexplained there. {} Free fewer parameters (--free), "
    "or measure again what is named above. Until then the scene as measured is the better guess."
)
"""What to do with a calibration that is not to be trusted, with one of `UNTOLD`."""

UNTOLD = {
    False: "A photograph with the monitor off (--monitor-off) and a mask tell paint, lamps and "
    "posters from shadows.",
    True: "A mask tells posters and sockets from shadows.",
}
"""What else may be given, by whether there were photographs with the monitor off."""


def calibrate(
    photo: arguments.PhotoArgument,
    scene: arguments.SceneOption,
    hidden: arguments.Hidden,
    out: Annotated[
        Path,
        option(
            "FILE",
            "Scene to write, NAME.xml; beside it NAME.json and NAME.png. Each appears complete or "
            "not at all.",
        ),
    ],
    free: Annotated[
        str | None,
        option(
            "NAME[=ERROR],...",
            "The scene's <default>s to find, such as occluder_dx,occluder_dz=0.005: ERROR is the "
            "ruler's, a standard deviation in the unit of NAME; without it, that of the <default> "
            "NAME_error if there is one. Default: all that have one.",
        ),
    ] = None,
    uncertain: Annotated[
        list[str] | None,
        option(
            "NAME[=ERROR],...",
            "Standard errors of <default>s that stay, such as occluder_turn=2: what they may do to "
            "the values found is counted in their errors, each on its own. Without ERROR, that of "
            "the <default> NAME_error. Repeatable.",
        ),
    ] = None,
    silhouette: Annotated[
        str | None,
        option(
            "SHAPE",
            "Find the form of an occluder nobody measured, not numbers: the shape of this id is "
            "replaced by a flat mask of cells in the rectangle about it. Beside the scene are "
            "written NAME_SHAPE.ply, the mask, and NAME_silhouette.png.",
        ),
    ] = None,
    cells: Annotated[
        str | None,
        option(
            "ROWSxCOLUMNS",
            "Cells of --silhouette. Default: 16 along the rectangle's longer side.",
        ),
    ] = None,
    samples: arguments.Samples = 144,
    background: arguments.MonitorOffOption = None,
    mask: arguments.MaskOption = None,
    seed: arguments.Seed = 0,
    define: arguments.Define = None,
) -> None:
    """Find the parameters of a scene that explain a photograph.

    They start from their defaults, or from -D, and stay within what the ruler's errors allow. The
    scene is written anew, and beside it a JSON file (values, uncertainties, the way there) and a
    picture. A result that is not to be trusted is written too, and says so.
    """
    from periscopy_sim.calibration.prior import free_parameters, start_values
    from periscopy_sim.figures.calibration import draw_calibration

    if silhouette is not None:
        refuse_others({"--free": free, "--uncertain": uncertain})
        find_silhouette(
            photo, scene, hidden, out, silhouette, cells,
            background=background, mask=mask, seed=seed, define=define,
        )  # fmt: skip
        return
    if cells is not None:
        raise SceneError("--cells are those of --silhouette SHAPE; name the shape")
    arguments.require_suffix(out, ".xml", "the scene")
    session = Session(scene, hidden, define, seed)
    path, given, timed = session.path, session.definitions, session.timed
    record, picture = out.with_suffix(".json"), out.with_suffix(".png")
    spare_inputs((out, record, picture), (photo, path, *(background or []), mask))
    freed = None if free is None else arguments.parse_errors(free, "--free")
    held = arguments.parse_errors(",".join(uncertain or []), "--uncertain")
    errors = arguments.known_errors(held, path, given)
    start_values(path, list(free_parameters(path, freed, given, errors)), given)
    with staged_file(out) as scene_file, staged_file(record) as json, staged_file(picture) as png:
        with progress("loading", lines=False):  # takes seconds
            from periscopy_sim.calibration.calibrate import calibrate as search
            from periscopy_sim.calibration.scene_covariance import SceneCovariance
            from periscopy_sim.rendering.scene.document import CALIBRATED

        wall = session.wall(photo, mask, background)
        _write_copy(scene_file, path, given, hidden, out)  # proves now that it can be written
        with timed("calibrate"), progress("calibrating") as report:
            found = search(
                wall.values,
                path,
                parse_size(hidden),
                freed,
                parameters=given,
                uncertain=errors,
                backgrounds=wall.monitor_off,
                mask=wall.mask,
                samples=samples,
                seed=seed,
                progress=report,
            )
        values = given | {name: f"{value:.9g}" for name, value in found.values.items()}
        values[CALIBRATED] = SceneCovariance.of(found).text()
        _write_copy(scene_file, path, values, hidden, out, _remark(found))
        summary = {
            "photograph": str(photo),
            "scene": str(path),
            "hidden_shape": session.scenario.hidden_shape,
            **pixel_record(mask, wall.mask, wall.monitor_off),
            "samples": samples,
            "warnings": [*session.warnings, *found.doubts],
            **told(found),
            "seconds": timed.seconds,
            "provenance": session.provenance,
        }
        write_json(json, summary)
        draw_calibration(png, wall.values, found, session.metadata)
    say_found(found, has_backgrounds=bool(wall.monitor_off))
    say_written(out, record, picture)
    if found.doubts:
        advice = DISTRUSTED.format(UNTOLD[bool(wall.monitor_off)])
        warn_boxed("this calibration is not to be trusted", found.doubts, advice)


def _remark(found: Calibration) -> str:
    """Return what the scene's file says of a calibration that is not to be trusted."""
    if not found.doubts:
        return ""
    return "periscopy calibrate: NOT TO BE TRUSTED: " + "; ".join(found.doubts)


def _write_copy(
    staged: Path, scene: Path, values: Mapping[str, str], hidden: str, out: Path, remark: str = ""
) -> None:
    """Write a scene with other defaults, and see that it loads from where it lies."""
    from periscopy_sim.calibration.calibrated_scene import write_copy
    from periscopy_sim.rendering.scene.load import load_scenario

    try:
        write_copy(scene, values, staged, remark)
        load_scenario(staged, parse_size(hidden))
    except SceneError as error:
        why = str(error).replace(str(staged), str(out))
        raise SceneError(
            f"--out {out}: a copy of scene '{scene}' does not load from there; name a file beside "
            f"the scene ({why})"
        ) from None
