"""`periscopy draw`: a laboratory to scale, which shows wrong numbers."""

from __future__ import annotations

import periscopy_sim as ps
from periscopy_sim.cli import options
from periscopy_sim.cli.output import progress, say_written
from periscopy_sim.cli.session import provenance_of, warn_without_shadows
from periscopy_sim.rendering.variant import require_vectorized
from periscopy_sim.shipped import find_scene
from periscopy_sim.storage.outputs.provenance import as_text
from periscopy_sim.storage.outputs.staging import staged_file

PATCHES = (18, 24)
"""Points of the monitor, for its shadows."""

PIXELS = (32, 32)
"""Pixels of the trial photograph."""


def draw(
    scene: options.SceneArgument,
    out: options.OutFile,
    define: options.Define = None,
) -> None:
    """Draw a scene to scale: plan, side view, shadows.

    Look at it to find wrong signs and units.
    """
    from periscopy_sim.figures.laboratory.drawing import draw_laboratory

    options.require_suffix(out, ".png", "the drawing")
    with staged_file(out) as staged:
        require_vectorized("a drawing")
        given = options.parse_definitions(define)
        scenario = ps.load_scenario(find_scene(scene), PATCHES, given, photograph=PIXELS)
        with progress("drawing"):
            draw_laboratory(staged, scenario, metadata=as_text(provenance_of(scenario)))
    say_written(out)
    warn_without_shadows(scenario, scene)
