"""What each pixel of a camera sees of the wall."""

from dataclasses import dataclass
from typing import Any

import mitsuba as mi
import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]


@dataclass(frozen=True, eq=False)
class Seen:
    """Points of the wall.

    Attributes
    ----------
    points
        (n, 3) metres.
    normal, across, up
        (3,) of the wall: towards the camera, and its own axes.
    places
        (n, 2) across and up, metres from what the middle of the film sees.
    positions
        (n, 2) on the photograph, from its centre in units of half its diagonal, right and down.
    """

    points: Array
    normal: Array
    across: Array
    up: Array
    places: Array
    positions: Array


def seen_by(scene: Any, pixels: Array, size: tuple[int, int]) -> Seen:
    """Return what pixels of a photograph of (rows, columns) see.

    The pixels are (n, 2) column and row, the first pixel's centre at (0.5, 0.5). One that sees
    something else than the wall is a ValueError.
    """
    rows, columns = size
    centre, half = np.array([columns, rows]) / 2, np.hypot(rows, columns) / 2
    positions = (pixels - centre) / half
    wall = next(shape for shape in scene.shapes() if shape.id() == "wall")
    hit = _hits(scene, pixels / [columns, rows])
    on_wall = np.broadcast_to(np.array(hit.shape == mi.ShapePtr(wall)).astype(bool), len(pixels))
    if not on_wall.all():
        column, row = pixels[np.argmin(on_wall)]
        raise ValueError(f"pixel (column {column:.1f}, row {row:.1f}) does not see the wall")
    axes = mi.SurfaceInteraction3f(wall.eval_parameterization(mi.Point2f(0.5, 0.5)))
    across, up = (
        np.array(axis).ravel() / np.linalg.norm(np.array(axis)) for axis in (axes.dp_du, axes.dp_dv)
    )
    points = np.array(hit.p, np.float64).T
    offsets = points - np.array(_hits(scene, np.array([[0.5, 0.5]])).p, np.float64).T
    places = np.stack([offsets @ across, offsets @ up], 1)
    return Seen(points, np.array(hit.n, np.float64).T[0], across, up, places, positions)


def pixel_centres(size: tuple[int, int]) -> Array:
    """Return (rows * columns, 2) column and row of a photograph's pixels' centres."""
    row, column = np.indices(size).reshape(2, -1) + 0.5
    return np.stack([column, row], 1)


def _hits(scene: Any, film: Array) -> Any:
    position = mi.Point2f(film.T.astype(np.float32))
    ray, _ = scene.sensors()[0].sample_ray(0.0, 0.5, position, mi.Point2f(0.5))
    return scene.ray_intersect(ray)
