"""Cameras of a pixel each that look at the wall from nearby: its irradiance in scalar variants."""

from __future__ import annotations

import itertools
import math
from typing import Any

import numpy as np

from periscopy_sim.errors import SceneError
from periscopy_sim.rendering.scene.load import shape_of
from periscopy_sim.rendering.variant import FIXED_BLOCKS
from periscopy_sim.scenario import Array

ALBEDO_SAMPLES = 1 << 18
"""Of all cameras together, but 64 of each at least: all that they see is divided by the albedo."""


class WallCameras:
    """What many parallelograms of a diffuse wall receive, by Mitsuba's own integrators.

    They have (M, 3) centres just off the wall, unit normals, and (M, 2, 3) edges down and across.
    A wall that is black at some of them or misses these is a `SceneError`, whose words call it as
    `name` does.
    """

    def __init__(self, scene: Any, name: str, points: Array, normals: Array, edges: Array) -> None:
        self._scene, self._sensor = scene, _sensor(points, normals, edges)
        if not _all_meet_wall(scene, points, normals, edges):
            raise SceneError(
                f"in scalar variants {name} must be as large as what the camera sees; make it so, "
                "or use llvm_ad_rgb or cuda_ad_rgb"
            )
        albedo = self._seen(
            {"type": "aov", "aovs": "wall:albedo"}, max(64, ALBEDO_SAMPLES // len(points)), 0
        )
        if not albedo.all():
            raise SceneError(
                f"in scalar variants {name} must be black nowhere, in no channel; paint it, or use "
                "llvm_ad_rgb or cuda_ad_rgb"
            )
        self._per_radiance = np.pi / albedo

    def irradiance(self, depth: int, samples: int, seed: int) -> Array:
        """Path trace the irradiance, (M, 3), to Mitsuba's `max_depth`, by so many samples each.

        They are rounded up to a square number. Depth 2 is light straight from the emitters, -1 all.
        The seed is of 32 bits.
        """
        return self._seen({"type": "path", "max_depth": depth}, samples, seed) * self._per_radiance

    def bounced_irradiance(self, depth: int, samples: int, seed: int) -> Array:
        """Return what of it is not straight from the emitters."""
        # The same seed: what both paths share cancels in part.
        return self.irradiance(depth, samples, seed) - self.irradiance(2, samples, seed)

    def _seen(self, integrator: dict[str, Any], samples: int, seed: int) -> Array:
        """Render (M, 3)."""
        import mitsuba as mi

        tracer = mi.load_dict({**integrator, **FIXED_BLOCKS})
        square = math.ceil(math.sqrt(samples)) ** 2
        picture = mi.render(
            self._scene, sensor=self._sensor, integrator=tracer, spp=square, seed=seed
        )
        return np.asarray(picture, dtype=np.float64).reshape(-1, 3)


def _all_meet_wall(scene: Any, points: Array, normals: Array, edges: Array) -> bool:
    """Return whether the wall lies behind the centres and corners, seen along the normals."""
    import mitsuba as mi

    wall = shape_of(scene, "wall")
    for down, across in [(0.0, 0.0), *itertools.product((-0.499, 0.499), repeat=2)]:
        starts = points + down * edges[:, 0] + across * edges[:, 1]
        for start, normal in zip(starts.tolist(), normals.tolist(), strict=True):
            met = scene.ray_intersect(mi.Ray3f(start, [-each for each in normal]))
            if not met.is_valid() or met.shape != wall:
                return False
    return True


def _sensor(points: Array, normals: Array, edges: Array) -> Any:
    """Return one sensor of many orthographic cameras of a pixel each."""
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
