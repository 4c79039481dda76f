"""`periscopy ambient`: photographs of the wall under ambient light."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import numpy as np
import typer

from periscopy_sim.cli import options
from periscopy_sim.cli.output import progress, say
from periscopy_sim.cli.session import Session
from periscopy_sim.shipped import ADVERSARIAL, REALISTIC
from periscopy_sim.storage.ambient_library import ambient_photographs
from periscopy_sim.storage.formats.exr import read_exr


def ambient(
    scene: options.SceneOption,
    out: options.ResumedFolder,
    names: Annotated[
        list[str] | None,
        typer.Argument(metavar="NAME", help="Scene files or shipped conditions."),
    ] = None,
    target: Annotated[
        float, options.option("NUMBER", "Relative error of a pixel to reach.", min=1e-5, max=1)
    ] = 3e-4,
    seed: options.Seed = 0,
    define: options.Define = None,
) -> None:
    """Photograph the wall of a scene under ambient light.

    The command path traces each condition and writes NAME.exr.
    """
    chosen = names or [*REALISTIC, *ADVERSARIAL]
    scenario = Session(scene, "1x1", define).scenario
    ambient_photographs(chosen, scenario, out, seed, target=target, progress=progress)
    for file in (out / f"{Path(name).stem}.exr" for name in chosen):
        held = read_exr(file)[1]
        error = np.hypot(float(held["relative_error"]), float(held["brightness_error"]))
        say(f"wrote {file}  relative error of a pixel {error:.1e}")
