"""Ambient light: the wall as lit by everything but the hidden monitor.

Brute force would need hours to push its noise below a camera's. But light that has bounced arrives
from all around and varies slowly over the wall, so that a coarse film and a smooth fit serve for
it; only the direct light, which stratified samples resolve well, needs every pixel.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from pathlib import Path

import numpy as np
from numpy.polynomial import legendre

from periscopy_sim.rendering.photograph import path_trace
from periscopy_sim.rendering.scene_nodes import SceneNodes
from periscopy_sim.rendering.variant import use_variant
from periscopy_sim.scenario import Array
from periscopy_sim.shipped import find_scene

COARSE = 24
"""Pixels along each side of the film for indirect light."""

DEGREE = 5
"""Degree, along each side, of the polynomial fitted to indirect light."""


def render_background(
    path: str | Path,
    parameters: Mapping[str, str] | None = None,
    *,
    samples: int = 1024,
    indirect_samples: int = 180**2,
    seed: int = 0,
    progress: Callable[[float], None] | None = None,
) -> Array:
    """Path trace an ambient scene, direct and indirect light apart.

    Parameters
    ----------
    path
        A scene file, or the name of a shipped one, with shape ``wall`` and sensor ``camera``,
        without a monitor.
    parameters
        Values for its ``<default>``s.
    samples
        Camera samples a pixel for direct light.
    indirect_samples
        Camera samples a coarse pixel for indirect light.
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
    path = find_scene(path)
    report = progress or (lambda _: None)
    direct = path_trace(
        _scene(path, parameters), 2, samples=samples, seed=seed,
        progress=lambda fraction: report(fraction / 3),
    )  # fmt: skip
    coarse = _scene(path, parameters, (COARSE, COARSE))
    # With the same seed both trace the same first segments: their difference is indirect light.
    every = path_trace(
        coarse, -1, samples=indirect_samples, seed=seed,
        progress=lambda fraction: report((1 + fraction) / 3),
    )  # fmt: skip
    first = path_trace(
        coarse, 2, samples=indirect_samples, seed=seed,
        progress=lambda fraction: report((2 + fraction) / 3),
    )  # fmt: skip
    return direct + smooth_fit(every - first, direct.shape[:2])


def smooth_fit(coarse: Array, shape: tuple[int, int], degree: int = DEGREE) -> Array:
    """Fit a polynomial to a coarse image by least squares and evaluate it on finer pixels.

    Parameters
    ----------
    coarse
        (r, c, 3) values at the centres of coarse pixels.
    shape
        (rows, columns) of the finer image of the same field.
    degree
        Degree along each side (Legendre polynomials).

    Returns
    -------
    ndarray
        (rows, columns, 3).
    """

    def basis(pixels: int) -> Array:
        centers = (2 * np.arange(pixels) + 1) / pixels - 1
        return np.asarray(legendre.legvander(centers, degree))

    down = basis(shape[0]) @ np.linalg.pinv(basis(coarse.shape[0]))
    across = basis(shape[1]) @ np.linalg.pinv(basis(coarse.shape[1]))
    return np.asarray(np.einsum("ri,ijk,cj->rck", down, coarse, across))


def _scene(
    path: Path, parameters: Mapping[str, str] | None, film_size: tuple[int, int] | None = None
) -> object:
    nodes = SceneNodes(path, parameters, required={"wall": "Shape", "camera": "Sensor"})
    nodes.average_pixels(film_size)
    return nodes.instantiate()
