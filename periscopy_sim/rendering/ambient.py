"""Ambient light: the wall as lit by everything but the hidden monitor."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from pathlib import Path

from periscopy_sim.rendering.photograph import path_trace
from periscopy_sim.rendering.scene_nodes import SceneNodes
from periscopy_sim.rendering.variant import use_variant
from periscopy_sim.scenario import Array


def render_background(
    path: Path,
    parameters: Mapping[str, str] | None = None,
    *,
    samples: int = 1024,
    seed: int = 0,
    progress: Callable[[float], None] | None = None,
) -> Array:
    """Path trace an ambient scene, with all interreflection.

    Parameters
    ----------
    path
        A scene file with shape ``wall`` and sensor ``camera``, without a monitor.
    parameters
        Values for its ``<default>``s.
    samples
        Camera samples a pixel.
    seed
        Seed of the sampler. The same seed and variant give the same bytes.
    progress
        Called with the fraction done.

    Returns
    -------
    ndarray
        (rows, columns, 3) float64 radiance.

    Raises
    ------
    SceneError
        If the wall or the camera is missing, or Mitsuba refuses the scene.
    """
    use_variant()
    nodes = SceneNodes(path, parameters, required={"wall": "Shape", "camera": "Sensor"})
    nodes.average_pixels()
    return path_trace(nodes.instantiate(), -1, samples=samples, seed=seed, progress=progress)
