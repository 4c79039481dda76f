"""`periscopy lab`, a scene from a ruler's numbers, and `periscopy draw`, that scene to scale."""

from pathlib import Path
from typing import Annotated

import periscopy_sim as ps
from periscopy_sim.cli import options
from periscopy_sim.cli.options import OUTPUT, argument, example_of, option, require_suffix
from periscopy_sim.cli.output import conclude, output_files, progress, written
from periscopy_sim.cli.session import Session

_MEASUREMENTS = "The measurements; see --example."
_OUT = "The scene's XML file; its meshes are written beside it."
Example = Annotated[bool, example_of("periscopy_sim.laboratory.document", "commented measurements")]


def lab(
    measurements: Annotated[Path, argument("MEASUREMENTS.yaml", _MEASUREMENTS, exists=True)],
    out: Annotated[Path, option("FILE", _OUT, group=OUTPUT)],
    example: Example = False,  # noqa: ARG001
) -> None:
    """Make a scene of a laboratory from a ruler's measurements.

    Each number and its error become <default>s of the scene.
    """
    require_suffix(out, ".xml", "the scene")
    written(*ps.lab(measurements, out))
    _Trial(str(out), []).check_shadows()
    conclude(f"look at it before you use it: periscopy draw {out} --out {out.with_suffix('.png')}")


def draw(
    scene: options.SceneArgument,
    out: options.OutFile,
    define: options.Define = None,
    camera: options.Cameras = None,
) -> None:
    """Draw a scene to scale: plan, side view, shadows.

    Look at it to find wrong signs and units.
    """
    options.require_suffix(out, ".png", "the drawing")
    with output_files(out) as (staged,):
        session = _Trial(scene, [], define, camera=camera)
        figure = ps.draw(session.scenario)
        with progress("drawing"):
            figure.savefig(staged, metadata=session.metadata)
    session.check_shadows()


class _Trial(Session):
    """A session of few pixels and patches: as many as shadows need."""

    pixels, patches = (64, 64), (18, 24)
