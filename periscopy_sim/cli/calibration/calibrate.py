"""`periscopy calibrate`: the parameters of a scene, or an occluder's form, from photographs."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

from periscopy_sim.cli import options as arguments
from periscopy_sim.cli.calibration.searches import Inputs, find_parameters, find_silhouette
from periscopy_sim.cli.options import PHOTOGRAPH, option
from periscopy_sim.cli.session import PhotoSession
from periscopy_sim.errors import SceneError

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
            exists=True,
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
    inputs = Inputs(session, photo, shown or [], monitor_off or [], mask)
    if silhouette is None and cells is not None:
        raise SceneError("--cells are those of --silhouette SHAPE; name the shape")
    if silhouette is None:
        find_parameters(inputs, out, free, uncertain or [])
    elif free or uncertain:
        raise SceneError("--silhouette finds a form, and all numbers stay; leave out --free")
    else:
        find_silhouette(inputs, out, silhouette, cells)
