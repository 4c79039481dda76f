"""`periscopy draw`: a laboratory to scale, which shows wrong numbers."""

from __future__ import annotations

from periscopy_sim.cli import options
from periscopy_sim.cli.output import progress, say_written
from periscopy_sim.cli.session import provenance_of, warn_without_shadows
from periscopy_sim.storage.outputs.staging import staged_file

PATCHES = {True: "18x24", False: "5x6"}
"""Points of the monitor for shadows, by whether the variant is vectorized."""

PIXELS = (32, 32)
"""Pixels of the trial photograph."""


def draw(
    scene: options.SceneArgument,
    out: options.OutFile,
    define: options.Define = None,
) -> None:
    """Draw a scene to scale: plan, side view, shadows, overview.

    The drawing shows wrong signs and units.
    """
    options.require_suffix(out, ".png", "the drawing")
    from periscopy_sim.figures.laboratory.drawing import draw_laboratory
    from periscopy_sim.rendering.scene.load import load_scenario
    from periscopy_sim.rendering.variant import is_vectorized, use_variant
    from periscopy_sim.shipped import find_scene
    from periscopy_sim.storage.outputs.provenance import as_text

    with staged_file(out) as staged:
        use_variant()
        scenario = load_scenario(
            find_scene(scene),
            options.parse_size(PATCHES[is_vectorized()]),
            options.parse_definitions(define),
            photograph=PIXELS,
        )
        with progress("drawing"):
            text = as_text(provenance_of(scenario))
            draw_laboratory(staged, scenario, metadata=text)
    say_written(out)
    warn_without_shadows(scenario, scene)
