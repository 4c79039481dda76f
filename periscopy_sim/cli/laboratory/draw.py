"""`periscopy draw`: a laboratory to scale, so that a wrong number is seen."""

from __future__ import annotations

from periscopy_sim.cli import inputs, options
from periscopy_sim.cli.output import progress, say_written
from periscopy_sim.storage.outputs.staging import staged_file

PATCHES = {True: "18x24", False: "5x6"}
"""Points of the monitor for shadows; fewer where one ray is traced after the other."""

PIXELS = (32, 32)
"""Points of the wall by which the scene is tried."""


def draw(
    scene: options.SceneArgument,
    out: options.OutFile,
    define: options.Define = None,
) -> None:
    """Draw a scene to scale: plan, side view, shadows, an overview.

    Look for wrong signs and units in it before an hour is lost.
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
            text = as_text(inputs.provenance_of(scenario, 0))
            draw_laboratory(staged, scenario, metadata=text)
    say_written(out)
    inputs.warn_without_shadows(scenario, scene)
