"""Light that bounces where nothing vectorizes: patch by patch, by Mitsuba's own path tracer."""

from __future__ import annotations

import math
from collections.abc import Callable

import numpy as np
from numpy.typing import NDArray

from periscopy_sim.rendering.photograph import Monitor, depth_of
from periscopy_sim.rendering.wall_cameras import WallCameras
from periscopy_sim.scenario import LIFT, Array, Scenario, pixel_edges, rises

WHITE_SAMPLES = 256
"""Samples of a pixel for a white image's direct light."""


def make_scalar_tracer(
    scenario: Scenario, sites: NDArray[np.intp], bounces: int | None
) -> Callable[[int, int], Array]:
    """Return what `make_tracer` does: bounced light, (S, N, 3), by so many paths and a seed.

    The paths of a site are shared out among the patches, of which each has one at least. The wall
    is diffuse.
    """
    lit, cameras = _lit_wall(scenario, sites)
    depth, patches = depth_of(bounces), scenario.transport_shape[1]

    def trace(paths: int, seed: int) -> Array:
        samples = math.ceil(paths / patches)
        seeds = np.random.SeedSequence(seed).generate_state(patches)
        light = np.empty((len(sites), patches, 3))
        for patch in range(patches):
            lit.show(np.eye(1, patches, patch).reshape(*scenario.hidden_shape, 1).repeat(3, 2))
            light[:, patch] = cameras.bounced_irradiance(depth, samples, int(seeds[patch]))
        return light * _radiance(scenario)

    return trace


def white_direct_light(scenario: Scenario, pixels: NDArray[np.intp], seed: int) -> Array:
    """Return what a white image sends straight, (P,), at some pixels, channels averaged."""
    _, cameras = _lit_wall(scenario, pixels)
    irradiance = cameras.irradiance(2, WHITE_SAMPLES, seed % 2**32).mean(axis=1)
    texture = 1.0 if scenario.wall_texture is None else scenario.wall_texture[pixels]
    return np.asarray(irradiance * _radiance(scenario) * texture)


def _lit_wall(scenario: Scenario, pixels: NDArray[np.intp]) -> tuple[Monitor, WallCameras]:
    """Return the monitor, which shows white, and the wall's pixels that it lights."""
    lit = Monitor(scenario, scenario.hidden_shape, only_monitor=True)
    points, normals, shape = scenario.wall_points, scenario.wall_normals, scenario.photograph_shape
    size = np.linalg.norm(np.ptp(points, axis=0)) or 1.0  # of a lone pixel a metre
    height = np.maximum(LIFT * size, rises(points, normals, shape))
    off, edges = points + height[:, np.newaxis] * normals, pixel_edges(points, normals, shape)
    name = f"the wall of scene '{scenario.path}'"
    return lit, WallCameras(lit.scene, name, off[pixels], normals[pixels], edges[pixels])


def _radiance(scenario: Scenario) -> float:
    """Return the radiance for an irradiance of 1, of a wall of the mean albedo."""
    assert scenario.wall_reflectance is not None
    return float(np.mean(scenario.wall_reflectance) / np.pi)
