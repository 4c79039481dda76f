"""`periscopy ambient`: photographs of the wall under ambient light."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import Annotated

import numpy as np
import typer
from numpy.typing import NDArray

from periscopy_sim.cli.options import Define, ResumedFolder, SceneOption, Seed, option
from periscopy_sim.cli.output import progress, say, to_be_continued
from periscopy_sim.cli.session import Session
from periscopy_sim.scenario import Scenario
from periscopy_sim.shipped import ADVERSARIAL, REALISTIC


def ambient(
    scene: SceneOption,
    out: ResumedFolder,
    names: Annotated[
        list[str] | None,
        typer.Argument(metavar="[NAME]...", help="Scene files or shipped conditions."),
    ] = None,
    target: Annotated[
        float, option("NUMBER", "Relative error of a pixel to reach.", min=1e-5, max=1)
    ] = 3e-4,
    seed: Seed = 0,
    define: Define = None,
) -> None:
    """Photograph the wall of a scene under ambient light.

    The command path traces each condition and writes NAME.exr.
    """
    from periscopy_sim.storage.formats.exr import read_exr

    chosen = names or [*REALISTIC, *ADVERSARIAL]
    session = Session(scene, define=define, seed=seed)
    files = [out / f"{Path(name).stem}.exr" for name in chosen]
    held_before = {file for file in files if file.is_file()}
    scenario = session.scenario
    with to_be_continued():
        ambient_photographs(chosen, scenario, out, seed, target=target)
    for file in files:
        held = read_exr(file)[1]
        error, common = (float(held[key]) for key in ("relative_error", "brightness_error"))
        done = "kept" if file in held_before else "wrote"
        say(
            f"{done} {file}  relative error of a pixel {np.hypot(error, common):.1e}, of which "
            f"{common:.1e} is common to all"
        )


def ambient_photographs(
    names: Sequence[str], scenario: Scenario, folder: Path, seed: int, *, target: float = 3e-4
) -> dict[str, NDArray[np.float64]]:
    """Photograph ambient conditions with a bar of progress; see `storage.ambient_library`."""
    from periscopy_sim.storage.ambient_library import ambient_photographs as photographs

    return photographs(names, scenario, folder, seed, target=target, progress=progress)
