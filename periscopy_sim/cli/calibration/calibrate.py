"""`periscopy calibrate`: the parameters of a scene, from photographs."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from periscopy_sim.cli import options as arguments
from periscopy_sim.cli.calibration.report import as_record, say_calibration
from periscopy_sim.cli.calibration.silhouette import find_silhouette
from periscopy_sim.cli.options import PHOTOGRAPH, option
from periscopy_sim.cli.output import fixable, progress, say_written, warn_boxed, write_json
from periscopy_sim.cli.session import PhotoSession
from periscopy_sim.errors import PhotographError, SceneError
from periscopy_sim.storage.outputs.staging import spare_inputs, staged_file

if TYPE_CHECKING:
    from periscopy_sim.calibration.result import Calibration

DISTRUSTED = (
    "Look at the picture. Measure again what is named above, free fewer parameters (--free), leave "
    "out what is not bare wall (--mask), or add a photograph with the monitor off (--monitor-off)."
)
"""What to do with a calibration that is not to be trusted."""

_SHOWN = (
    "A picture that the monitor showed, in the order of the photographs; repeatable. Photographs "
    "beyond these have unknown pictures."
)
_FREE = (
    "<default>s to find, such as occluder_dx,occluder_dz=0.005: ERROR is the standard deviation of "
    "the measured value. [default: all NAME with a NAME_error]"
)
_UNCERTAIN = "Standard errors of <default>s that stay; those of the result count them; repeatable."
_SILHOUETTE = "Find the form of this shape, a flat mask of cells in the rectangle about it."
_CELLS = "Cells of --silhouette. [default: 16 along the longer side]"
_OUT = "Scene to write, NAME.xml; beside it NAME.json and NAME.png."


def calibrate(
    photo: Annotated[
        list[Path],
        typer.Argument(
            metavar="PHOTO...",
            help="Photographs of one laboratory, its scene unchanged.",
            rich_help_panel=PHOTOGRAPH,
        ),
    ],
    session: PhotoSession,
    out: Annotated[Path, option("FILE", _OUT, group=arguments.OUTPUT)],
    shown: Annotated[list[str] | None, option("IMAGE", _SHOWN, group=PHOTOGRAPH)] = None,
    free: Annotated[str | None, option("NAME[=ERROR],...", _FREE)] = None,
    uncertain: Annotated[list[str] | None, option("NAME[=ERROR],...", _UNCERTAIN)] = None,
    silhouette: Annotated[str | None, option("SHAPE", _SILHOUETTE)] = None,
    cells: Annotated[str | None, option("ROWSxCOLUMNS", _CELLS)] = None,
    monitor_off: arguments.MonitorOffOption = None,
    mask: arguments.MaskOption = None,
) -> None:
    """Find the parameters of a scene that explain photographs best.

    The search starts from the scene's values, or those of -D, and their errors. A JSON file tells
    values, standard errors and the path of the search. A result that is not to be trusted is
    written, too, and says so.
    """
    arguments.require_suffix(out, ".xml", "the scene")
    if silhouette is not None:
        if free or uncertain:
            raise SceneError("--silhouette finds a form, and all numbers stay; leave out --free")
        find_silhouette(session, photo, shown or [], out, silhouette, cells, monitor_off, mask)
        return
    if cells is not None:
        raise SceneError("--cells are those of --silhouette SHAPE; name the shape")
    if len(shown or []) > len(photo):
        raise PhotographError(f"--shown: {len(shown or [])} pictures of {len(photo)} photographs")
    from periscopy_sim.calibration.prior import free_parameters, start_values
    from periscopy_sim.figures.calibration import draw_calibration

    path, given = session.path, session.definitions
    record, picture = out.with_suffix(".json"), out.with_suffix(".png")
    spare_inputs((out, record, picture), (*photo, path, *(monitor_off or []), mask))
    freed = None if free is None else arguments.parse_errors(free, "--free")
    errors = arguments.known_errors(",".join(uncertain or []), path, given)
    start_values(path, list(free_parameters(path, freed, given, errors)), given)
    with staged_file(out) as scene_file, staged_file(record) as json, staged_file(picture) as png:
        with progress("loading"):  # takes seconds
            from periscopy_sim.calibration.calibrate import calibrate as search
            from periscopy_sim.calibration.scene_covariance import SceneCovariance
            from periscopy_sim.rendering.scene.document import CALIBRATED

        wall = session.wall(photo[0], mask, monitor_off)
        others = [session.photograph(file, wall.mask).values for file in photo[1:]]
        images = [session.hidden_image(name) for name in shown or []]
        _write_copy(session, scene_file, given, out)  # proves now that it can be written
        with session.timed("calibrate"), fixable("calibrate"), progress("calibrating") as report:
            result = search(
                [wall.values, *others],
                path,
                session.size,
                freed,
                shown=images,
                parameters=given,
                uncertain=errors,
                backgrounds=wall.monitor_off,
                mask=wall.mask,
                seed=session.seed,
                progress=report,
            )
        values = given | {name: f"{value:.9g}" for name, value in result.values.items()}
        values[CALIBRATED] = SceneCovariance.of(result).text()
        _write_copy(session, scene_file, values, out, _remark(result))
        summary = {
            "photograph": str(photo[0]),
            "photographs": [str(file) for file in photo],
            "shown": shown or [],
            "scene": str(path),
            "hidden_shape": session.scenario.hidden_shape,
            **session.record,
            "warnings": [*session.warnings, *result.doubts],
            **as_record(result),
            "seconds": session.timed.seconds,
            "provenance": session.provenance,
        }
        write_json(json, summary)
        draw_calibration(png, wall.values, result, session.metadata)
    say_calibration(result)
    say_written(out, record, picture)
    if result.doubts:
        warn_boxed("this calibration is not to be trusted", result.doubts, DISTRUSTED)


def _remark(result: Calibration) -> str:
    """Return what the scene's file says of a calibration that is not to be trusted."""
    if not result.doubts:
        return ""
    return "periscopy calibrate: NOT TO BE TRUSTED: " + "; ".join(result.doubts)


def _write_copy(
    session: PhotoSession, staged: Path, values: Mapping[str, str], out: Path, remark: str = ""
) -> None:
    """Write a scene with other defaults, and see that it loads from where it lies."""
    from periscopy_sim.calibration.calibrated_scene import write_copy
    from periscopy_sim.rendering.scene.load import load_scenario

    try:
        write_copy(session.path, values, staged, remark)
        load_scenario(staged, session.size)
    except SceneError as error:
        why = str(error).replace(str(staged), str(out))
        raise SceneError(
            f"--out {out}: a copy of scene '{session.path}' does not load from there; name a file "
            f"beside the scene ({why})"
        ) from None
