"""Ambient light where nothing vectorizes: the ambient scene's own wall, path traced by Mitsuba."""

from __future__ import annotations

from functools import partial
from typing import Any

import numpy as np

from periscopy_sim.errors import SceneError
from periscopy_sim.rendering.ambient.light_paths import scatters_alike
from periscopy_sim.rendering.ambient.replicas import SITES, Part
from periscopy_sim.rendering.scene.load import shape_of
from periscopy_sim.rendering.wall_cameras import WallCameras
from periscopy_sim.rendering.wall_polynomials import chosen_sites
from periscopy_sim.scenario import Array, pixel_edges

DIRECT_SAMPLES = 64
"""Samples of each pixel in a round."""


def scalar_parts(
    scene: Any, points: Array, normals: Array, shape: tuple[int, int], rays: int
) -> list[Part]:
    """Estimate direct light at every pixel and bounced light at a few, in scalar variants.

    The (M, 3) points lie just off the scene's own wall, row-major. A wall that is not diffuse, is
    black or misses some of the points is a `SceneError`.
    """
    if not scatters_alike(shape_of(scene, "wall").bsdf().flags()):
        raise SceneError(
            "in scalar variants the ambient scene's own wall must be diffuse; give it such a bsdf, "
            "or use llvm_ad_rgb or cuda_ad_rgb"
        )
    edges, everywhere = pixel_edges(points, normals, shape), np.arange(len(points))
    sites = chosen_sites(shape, SITES)
    whole, few = (
        WallCameras(scene, "the ambient scene's own wall", points[at], normals[at], edges[at])
        for at in (everywhere, sites)
    )
    # Rounds of both take about as long.
    return [
        Part(partial(whole.irradiance, 2, DIRECT_SAMPLES), everywhere, shape),
        Part(partial(few.bounced_irradiance, -1, rays), sites, shape),
    ]
