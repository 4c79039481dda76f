"""Computational periscopy: from a Mitsuba scene and a photograph of a wall to the hidden image.

The public names below are loaded when first used, so that importing the package imports no
renderer.
"""

from __future__ import annotations

from importlib import import_module
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from periscopy_sim.analytic.point_light import (
        paper_grid,
        point_light_backgrounds,
        point_light_response,
    )
    from periscopy_sim.analytic.transport import analytic_transport
    from periscopy_sim.errors import PeriscopyError
    from periscopy_sim.evaluation.diagnostics import diagnose
    from periscopy_sim.evaluation.metrics import gain_matched, mean_squared_error, psnr, registered
    from periscopy_sim.measurement import add_noise, composite
    from periscopy_sim.reconstruction.periscope import Periscope, Reconstruction
    from periscopy_sim.reconstruction.preconditioner import Preconditioner, form_preconditioner
    from periscopy_sim.reconstruction.repair import repair
    from periscopy_sim.reconstruction.total_variation import prox_total_variation
    from periscopy_sim.rendering.ambient import render_background
    from periscopy_sim.rendering.photograph import render_photograph
    from periscopy_sim.rendering.scene_file import load_scenario
    from periscopy_sim.rendering.transport import render_transport
    from periscopy_sim.rendering.variant import use_variant
    from periscopy_sim.scenario import Scenario
    from periscopy_sim.shipped import find_image, find_scene
    from periscopy_sim.storage.photographs import read_photograph
    from periscopy_sim.storage.pictures import read_hidden_image

_HOMES = {
    "analytic.point_light": ("paper_grid", "point_light_backgrounds", "point_light_response"),
    "analytic.transport": ("analytic_transport",),
    "errors": ("PeriscopyError",),
    "evaluation.diagnostics": ("diagnose",),
    "evaluation.metrics": ("gain_matched", "mean_squared_error", "psnr", "registered"),
    "measurement": ("add_noise", "composite"),
    "reconstruction.periscope": ("Periscope", "Reconstruction"),
    "reconstruction.preconditioner": ("Preconditioner", "form_preconditioner"),
    "reconstruction.repair": ("repair",),
    "reconstruction.total_variation": ("prox_total_variation",),
    "rendering.ambient": ("render_background",),
    "rendering.photograph": ("render_photograph",),
    "rendering.scene_file": ("load_scenario",),
    "rendering.transport": ("render_transport",),
    "rendering.variant": ("use_variant",),
    "scenario": ("Scenario",),
    "shipped": ("find_image", "find_scene"),
    "storage.photographs": ("read_photograph",),
    "storage.pictures": ("read_hidden_image",),
}
_HOME = {name: home for home, names in _HOMES.items() for name in names}

__all__ = sorted(_HOME)  # noqa: PLE0605


def __getattr__(name: str) -> Any:
    if name not in _HOME:
        raise AttributeError(f"module 'periscopy_sim' has no attribute '{name}'")
    return getattr(import_module(f"periscopy_sim.{_HOME[name]}"), name)


def __dir__() -> list[str]:
    return __all__
