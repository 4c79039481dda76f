"""What the commands read: the scene, hidden images, photographs, masks."""

from __future__ import annotations

import sys
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from periscopy_sim.cli.options import parse_definitions, parse_size
from periscopy_sim.cli.output import fixable, warn
from periscopy_sim.errors import PhotographError

if TYPE_CHECKING:
    from periscopy_sim.photograph import Photograph
    from periscopy_sim.photographs.defects import DefectivePixels
    from periscopy_sim.scenario import Array, Scenario

Mask = NDArray[np.bool_]
SUGGESTED = "mask.png"
"""Where a command that finds defective pixels writes a mask that leaves them out."""


def load(name: str, hidden: str, definitions: list[str] | None) -> Scenario:
    """Load a scene from what a command was given."""
    from periscopy_sim.rendering.scene.load import load_scenario
    from periscopy_sim.shipped import find_scene

    return load_scenario(find_scene(name), parse_size(hidden), parse_definitions(definitions))


def provenance_of(scenario: Scenario, seed: int | None) -> dict[str, Any]:
    """Record versions, scene, variant, seed and command line."""
    import mitsuba as mi

    from periscopy_sim.storage.outputs.provenance import provenance

    command = ["periscopy", *sys.argv[1:]]
    record = provenance(scenario.path, mi.variant(), seed, command, scenario.parameters)
    return {**record, "parameters": dict(scenario.parameters)}


# -- doubts about a scene ------------------------------------------------------------------------


def warn_without_shadows(scenario: Scenario, name: str) -> list[str]:
    """Warn where no occluder casts a shadow into the camera's view; return that line, if any."""
    from periscopy_sim.rendering.checks import shadow_doubt

    doubt = shadow_doubt(scenario)
    if doubt:
        warn(f"{name}: {doubt}")
    return [f"{name}: {doubt}"] if doubt else []


# -- images and masks ----------------------------------------------------------------------------


def hidden_image(name: str, hidden_shape: tuple[int, int]) -> NDArray[np.float64]:
    """Read a hidden image, (R, C, 3): a file, or a shipped one by its name."""
    from periscopy_sim.shipped import find_image
    from periscopy_sim.storage.pictures import read_hidden_image

    return read_hidden_image(find_image(name), hidden_shape)


def read_mask(path: Path | None, scenario: Scenario) -> Mask | None:
    """Read the mask that a command was given, (rows, columns); None if it was given none."""
    from periscopy_sim.model.observation import checked_mask
    from periscopy_sim.storage import photographs

    if path is None:
        return None
    mask = photographs.read_mask(path, scenario.photograph_shape)
    with fixable(str(path)):
        return checked_mask(mask, scenario.transport_shape)


def read_photograph(path: Path, scenario: Scenario, mask: Mask | None = None) -> Photograph:
    """Read a photograph of the size that the scene's camera sees, and print its warnings."""
    from periscopy_sim.storage import photographs

    photograph = photographs.read_photograph(path, scenario.photograph_shape, mask)
    for warning in photograph.warnings:
        warn(warning)
    return photograph


def read_backgrounds(
    paths: list[Path] | None, scenario: Scenario, mask: Mask | None = None
) -> dict[str, Array]:
    """Read photographs with the monitor off, by the names of their files; print their warnings."""
    backgrounds: dict[str, Array] = {}
    for path in paths or []:
        if str(path) in backgrounds:
            raise PhotographError(f"--monitor-off {path} is given twice")
        backgrounds[str(path)] = read_photograph(path, scenario, mask).values
    return backgrounds


@dataclass(frozen=True, eq=False)
class Defects:
    """Pixels of a photograph that measure no light of the wall and that no mask leaves out."""

    pixels: DefectivePixels
    used: Mask | None
    """(rows, columns), the mask that the command was given; without one, all but a bad border."""
    sound: Mask
    """(rows, columns), what is used and has no defect."""
    warnings: Sequence[str]
    """A line of each kind, if there are any."""

    def suggest_mask(self, folder: Path, text: Mapping[str, str]) -> None:
        """Write a mask that leaves them out too, if any are used."""
        from periscopy_sim.storage.pictures import write_png

        if not self.sound[... if self.used is None else self.used].all():
            write_png(folder / SUGGESTED, np.repeat(self.sound[..., np.newaxis], 3, axis=2), text)


def look_for_defects(
    photograph: Array,
    mask: Mask | None,
    name: str,
    suggested: Path | None = None,
    *,
    maskable: bool = True,
) -> Defects:
    """Look for defects of a photograph, (rows, columns, 3), and warn of them.

    A border that stands out is not used, where no mask says what is and the method is `maskable`;
    else it is warned of. `suggested` is where a mask that leaves all of them out will be.
    """
    from periscopy_sim.photographs.border import BadBorder, bad_border
    from periscopy_sim.photographs.defects import defective_pixels

    remedy = f"leave them out by --mask {suggested or 'FILE'}"
    border = bad_border(photograph) if mask is None else BadBorder()
    sound = border.inside(photograph.shape[:2]) if mask is None else mask
    used, warnings = mask, []
    if border:
        outstanding = f"border lines that are far too dark or bright ({border})"
        if maskable:
            used = sound
            warnings.append(f"{name}: left out {outstanding}; --mask takes exactly what it shows")
        else:
            warnings.append(f"{name}: {outstanding}; {remedy}")
    found = defective_pixels(photograph, used)
    if found.any_kind.any():
        warnings.append(f"{name}: {found}; {remedy}")
    for warning in warnings:
        warn(warning)
    return Defects(found, used, sound & ~found.any_kind, warnings)


def mask_record(path: Path | None, mask: Mask | None) -> dict[str, Any]:
    """Return the entries of a summary about pixels that were left out."""
    return {"mask": path, "pixels_left_out": 0 if mask is None else np.count_nonzero(~mask)}
