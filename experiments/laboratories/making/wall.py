"""What each pixel of a camera sees of the wall."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import mitsuba as mi
import numpy as np
from numpy.typing import NDArray

from experiments.laboratories.making.camera import Camera

Array = NDArray[np.float64]


@dataclass(frozen=True, eq=False)
class Seen:
    """Points of the wall.

    Attributes
    ----------
    points
        (n, 3) metres.
    normal
        (3,) of the wall, towards the camera.
    places
        (n, 2) across and up in the wall's own axes, metres from what the middle of the film sees.
    positions
        (n, 2) on the photograph, from its centre in units of half its diagonal, right and down.
    """

    points: Array
    normal: Array
    places: Array
    positions: Array


def film_size(scene: Any) -> tuple[int, int]:
    """Return (rows, columns) of the scene's film."""
    columns, rows = scene.sensors()[0].film().size()
    return int(rows), int(columns)


def seen_by(scene: Any, camera: Camera, pixels: Array, size: tuple[int, int]) -> Seen:
    """Return what a photograph's pixels see.

    Parameters
    ----------
    scene
        Of Mitsuba, with shape ``wall`` and one sensor.
    camera
        Whose lens may bend the rays.
    pixels
        (n, 2) column and row on the photograph, the first pixel's centre at (0.5, 0.5).
    size
        (rows, columns) of the photograph.

    Raises
    ------
    ValueError
        If a pixel sees something else than the wall.
    """
    rows, columns = size
    half = np.hypot(rows, columns) / 2
    positions = (pixels - [columns / 2, rows / 2]) / half
    ideal = camera.ideal(positions) * half + [columns / 2, rows / 2]
    points, normals, wall = _hits(scene, ideal / [columns, rows])
    if not wall.all():
        column, row = pixels[np.argmin(wall)]
        raise ValueError(f"pixel (column {column:.1f}, row {row:.1f}) does not see the wall")
    middle, _, _ = _hits(scene, np.array([[0.5, 0.5]]))
    shape = next(shape for shape in scene.shapes() if shape.id() == "wall")
    axes = mi.SurfaceInteraction3f(shape.eval_parameterization(mi.Point2f(0.5, 0.5)))
    across, up = (
        np.array(axis).ravel() / np.linalg.norm(np.array(axis)) for axis in (axes.dp_du, axes.dp_dv)
    )
    offsets = points - middle
    return Seen(points, normals[0], np.stack([offsets @ across, offsets @ up], 1), positions)


def pixel_centres(size: tuple[int, int]) -> Array:
    """Return (rows * columns, 2) column and row of a photograph's pixels' centres."""
    row, column = np.indices(size).reshape(2, -1) + 0.5
    return np.stack([column, row], 1)


def _hits(scene: Any, film: Array) -> tuple[Array, Array, NDArray[np.bool_]]:
    position = mi.Point2f(film.T.astype(np.float32))
    ray, _ = scene.sensors()[0].sample_ray(0.0, 0.5, position, mi.Point2f(0.5))
    hit = scene.ray_intersect(ray)
    wall = next(shape for shape in scene.shapes() if shape.id() == "wall")
    on_wall = np.array(hit.shape == mi.ShapePtr(wall)).astype(bool)
    return (
        np.array(hit.p, np.float64).T,
        np.array(hit.n, np.float64).T,
        np.broadcast_to(on_wall, len(film)),
    )
