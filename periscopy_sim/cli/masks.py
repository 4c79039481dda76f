"""What the commands do with masks: read one, and suggest one where a photograph has defects."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import numpy as np
import typer
from numpy.typing import NDArray

from periscopy_sim.cli.arguments import warn
from periscopy_sim.errors import PhotographError

if TYPE_CHECKING:
    from periscopy_sim.photographs.defects import DefectivePixels
    from periscopy_sim.scenario import Scenario

Mask = NDArray[np.bool_]
MaskOption = Annotated[
    Path | None,
    typer.Option(
        "--mask",
        metavar="FILE",
        help="A grey picture of the photograph's size (PNG, TIFF, JPEG, EXR, NPY or NPZ with key "
        "mask): bright where the wall is used, black where it is left out.",
    ),
]
SUGGESTED = "mask.png"
"""Where a command that finds defective pixels writes a mask that leaves them out."""


def read(path: Path | None, scenario: Scenario) -> Mask | None:
    """Read the mask that a command was given, (rows, columns); None if it was given none.

    Raises
    ------
    PhotographError
        If it cannot be read, is of another size, or leaves fewer pixels than there are patches.
    """
    from periscopy_sim.storage.masks import read_mask

    if path is None:
        return None
    mask = read_mask(path, scenario.photograph_shape)
    pixels, patches = int(mask.sum()), scenario.transport_shape[1]
    if pixels < patches:
        raise PhotographError(
            f"{path}: leaves {pixels} pixels of the wall, fewer than the {patches} patches; leave "
            "out less, or ask for fewer patches"
        )
    return mask


def record(path: Path | None, mask: Mask | None) -> dict[str, Any]:
    """Tell in a summary what was left out."""
    left_out = 0 if mask is None else np.count_nonzero(~mask)
    return {"mask": path, "pixels_left_out": left_out}


def warn_of(defects: DefectivePixels, name: str, suggested: Path | None = None) -> list[str]:
    """Print and return a warning of defective pixels, if there are any.

    Parameters
    ----------
    defects
        Of the pixels used.
    name
        What to call the photograph.
    suggested
        Where a mask that leaves them out will be.
    """
    if not defects.any_kind.any():
        return []
    warning = f"{name}: {defects}; leave them out by --mask {suggested or 'FILE'}"
    warn(warning)
    return [warning]


def suggest(
    folder: Path, defects: DefectivePixels, mask: Mask | None, text: Mapping[str, str]
) -> None:
    """Write a mask that leaves out defective pixels, if there are any, beside those given."""
    from periscopy_sim.storage.pictures import write_png

    if defects.any_kind.any():
        sound = ~defects.any_kind if mask is None else mask & ~defects.any_kind
        write_png(folder / SUGGESTED, np.repeat(sound[..., np.newaxis], 3, axis=2), text)
