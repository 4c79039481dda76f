"""`periscopy lab`: a scene from a ruler's numbers."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

import periscopy_sim as ps
from periscopy_sim.cli.laboratory.draw import PIXELS
from periscopy_sim.cli.options import OUTPUT, option, require_suffix
from periscopy_sim.cli.output import say, say_written
from periscopy_sim.cli.session import warn_without_shadows
from periscopy_sim.errors import PeriscopyError


def lab(
    measurements: Annotated[
        Path | None, typer.Argument(metavar="MEASUREMENTS.yaml", help="The measurements.")
    ] = None,
    out: Annotated[
        Path | None,
        option("FILE", "The scene's XML file; its meshes are written beside it.", group=OUTPUT),
    ] = None,
    example: Annotated[
        bool, typer.Option("--example", help="Print commented measurements and exit.")
    ] = False,
) -> None:
    """Make a scene of a laboratory from a ruler's measurements.

    Each number and its error become <default>s of the scene.
    """
    from periscopy_sim.laboratory.document import EXAMPLE

    if example:
        print(EXAMPLE.read_text("utf-8"), end="")
        return
    if measurements is None or out is None:
        raise PeriscopyError("name MEASUREMENTS.yaml and --out; --example prints measurements")
    require_suffix(out, ".xml", "the scene")
    say_written(*ps.build_laboratory(measurements, out))
    warn_without_shadows(ps.load_scenario(out, (1, 1), photograph=PIXELS), str(out))
    say(f"look at it before you use it: periscopy draw {out} --out {out.with_suffix('.png')}")
