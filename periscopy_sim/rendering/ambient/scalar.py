"""Ambient light where nothing vectorizes: the ambient scene's own wall, path traced by Mitsuba."""

from __future__ import annotations

from typing import Any

import numpy as np

from periscopy_sim.errors import SceneError
from periscopy_sim.rendering.ambient.irradiance import pixel_edges
from periscopy_sim.rendering.ambient.light_paths import scatters_alike
from periscopy_sim.rendering.ambient.replicas import RAYS, SITES, Part
from periscopy_sim.rendering.scene.load import shape_of
from periscopy_sim.rendering.wall_polynomials import chosen_sites
from periscopy_sim.scenario import Array

DIRECT_SAMPLES = 64
"""Samples of each pixel in a round."""


def scalar_parts(scene: Any, points: Array, normals: Array, shape: tuple[int, int]) -> list[Part]:
    """Estimate direct light at every pixel and bounced light at a few, in scalar variants.

    Irradiance is the radiance of the scene's own diffuse wall over its reflectance / π, at (M, 3)
    points just off that wall, row-major. A wall that is not diffuse, is black or misses some of the
    points is a `SceneError`.
    """
    edges = pixel_edges(points, normals, shape)
    sites = chosen_sites(shape, SITES)
    whole = _cameras(points, normals, edges)
    few = _cameras(points[sites], normals[sites], edges[sites])
    reflectance = _seen(scene, whole, {"type": "aov", "aovs": "wall:albedo"}, 16, 0)
    if not scatters_alike(shape_of(scene, "wall").bsdf().flags()) or not reflectance.all():
        raise SceneError(
            "in scalar variants the ambient scene's own wall must be diffuse, not black, and as "
            "large as what the camera sees; fix it, or use llvm_ad_rgb or cuda_ad_rgb"
        )

    def direct(seed: int) -> Array:
        path = {"type": "path", "max_depth": 2}
        return _seen(scene, whole, path, DIRECT_SAMPLES, seed) * np.pi / reflectance

    def bounced(seed: int) -> Array:
        # The same seed: what both paths share cancels in part.
        all_light, direct_light = (
            _seen(scene, few, {"type": "path", "max_depth": depth}, RAYS, seed) for depth in (-1, 2)
        )
        return (all_light - direct_light) * np.pi / reflectance[sites]

    # Rounds of both take about as long.
    return [Part(direct, np.arange(len(points)), shape), Part(bounced, sites, shape)]


def _cameras(points: Array, normals: Array, edges: Array) -> Any:
    """One sensor of many orthographic cameras of a pixel each, that look at the wall nearby."""
    import mitsuba as mi

    pixel = {"type": "hdrfilm", "width": 1, "height": 1, "rfilter": {"type": "box"}}
    film = {**pixel, "width": len(points), "pixel_format": "rgb", "component_format": "float32"}
    cameras = {}
    for number, (point, normal, (down, across)) in enumerate(
        zip(points, normals, edges, strict=True)
    ):
        to_world = np.eye(4)
        to_world[:3] = np.stack([-across / 2, -down / 2, -normal, point], axis=1)
        cameras[f"pixel{number:09d}"] = {
            "type": "orthographic",
            "to_world": mi.ScalarTransform4f(to_world),
            "near_clip": 1e-7,
            "far_clip": 1.0,
            "film": pixel,
        }
    sampler = {"type": "multijitter"}
    return mi.load_dict({"type": "batch", "film": film, "sampler": sampler, **cameras})


def _seen(scene: Any, cameras: Any, integrator: dict[str, Any], samples: int, seed: int) -> Array:
    """Render (M, 3)."""
    import mitsuba as mi

    tracer = mi.load_dict(integrator)
    picture = mi.render(scene, sensor=cameras, integrator=tracer, spp=samples, seed=seed)
    return np.asarray(picture, dtype=np.float64).reshape(-1, 3)
