"""Eq. 4: the response of the wall to a point light, and the matrix B of many of them."""

import numpy as np

from periscopy_sim.numerics import Array
from periscopy_sim.numerics.products import compiled_reordered
from periscopy_sim.numerics.validation import InputError, plain_array
from periscopy_sim.view import Geometry, View

FIELD_OF_VIEW = 0.401
"""Side of the paper's field of view, in metres."""


def point_light_response(lights: Array, points: Array, normals: Array) -> Array:
    """Evaluate ψ(α)_i = ((α − c_i) · n_i) / ‖α − c_i‖³ (Eq. 4).

    Parameters
    ----------
    lights
        (L, 3) positions α in metres.
    points
        (M, 3) wall points c_i in metres.
    normals
        (M, 3) unit normals, or (3,) for one plane.

    Returns
    -------
    ndarray
        (M, L) float64, in 1/m². A light behind the wall gives 0.

    Raises
    ------
    ValueError
        If a light lies on a wall point.
    """
    return np.ascontiguousarray(responses(lights, points, normals).T)


def responses(lights: Array, points: Array, normals: Array) -> Array:
    """Return the transpose, (L, M), of `point_light_response`."""
    ψ, normals = np.empty((len(lights), len(points))), np.broadcast_to(normals, points.shape)
    for α, row in zip(np.asarray(lights, np.float64), ψ, strict=True):
        # Within a millionth of the size of the whole, a distance is all rounding error.
        if _respond(α, points, normals, row) <= 1e-12:
            raise InputError("a point light lies on the wall; move it away")
    return ψ


@compiled_reordered
def _respond(α: Array, c: Array, n: Array, ψ: Array) -> float:
    """Fill ψ, (M,), with one light's response; return its least squared distance over its most."""
    nearest, farthest = np.inf, 0.0
    for i in range(len(ψ)):
        x, y, z = α[0] - c[i, 0], α[1] - c[i, 1], α[2] - c[i, 2]
        squared = x * x + y * y + z * z
        height = x * n[i, 0] + y * n[i, 1] + z * n[i, 2]
        nearest, farthest = min(nearest, squared), max(farthest, squared)
        ψ[i] = max(height, 0.0) / (squared * np.sqrt(squared))  # a power is slow
    return nearest / farthest


def paper_grid(step: float = 0.75) -> Array:
    """Return the paper's grid of lights (Sec. 3.1): [-3, 3) x [1, 7) x [-3, 3) m, 8 x 8 x 8.

    Parameters
    ----------
    step
        Spacing in metres.

    Returns
    -------
    ndarray
        (512, 3) for the default step: across, distance from the wall, up, relative to the centre of
        the field of view.
    """
    sideways = np.arange(-3.0, 3.0 - 1e-9, step)
    away = np.arange(1.0, 7.0 - 1e-9, step)
    grid = np.meshgrid(sideways, away, sideways, indexing="ij")
    return np.stack([axis.ravel() for axis in grid], axis=1)


def point_light_backgrounds(seen: View | Geometry, grid: Array | None = None) -> Array:
    """Return B: one column for each point light of a grid around the field of view (Sec. 3.1).

    Parameters
    ----------
    seen
        What the camera sees of the wall, or a scenario with it; the wall may stand in any
        orientation.
    grid
        (L, 3) lights in metres, as (across, distance from the wall, up) about the centre of the
        field of view; None for the paper's, scaled by the ratio of the fields of view, so that
        the scene's unit does not matter.

    Returns
    -------
    ndarray
        B, (M, L) float64 in 1/m², averaged over the points of each pixel, times its `View.paint`.

    Raises
    ------
    ValueError
        If the grid is not (L, 3), or a light is not in front of the wall.
    """
    view = seen if isinstance(seen, View) else seen.view
    frame = view.frame
    offsets = _stretched_grid(view) if grid is None else plain_array(grid, "the grid")
    if offsets.ndim != 2 or offsets.shape[1] != 3 or not (offsets[:, 1] > 0).all():
        raise InputError(
            f"a grid of lights is (L, 3), not {offsets.shape}, each in front of the wall (second "
            "coordinate above 0)"
        )
    lights = frame.center + offsets @ np.stack([frame.across, frame.normal, frame.up])
    B = point_light_response(
        lights, view.points.reshape(-1, 3), view.painted_normals.reshape(-1, 3)
    )
    return np.asarray(B.reshape(*view.points.shape[:2], -1).mean(axis=1))


def _stretched_grid(view: View) -> Array:
    """Return the paper's grid for a field of view of another size; as it is for a lone pixel."""
    frame, count = view.frame, np.array(view.shape)
    seen = (view.centers - frame.center) @ np.stack([frame.up, frame.across]).T
    sides = (np.ptp(seen, axis=0) * count / np.maximum(count - 1, 1))[count > 1]
    # Rounded: the wall's points are of single precision.
    return paper_grid() * float(f"{np.prod(sides / FIELD_OF_VIEW) ** (1 / max(len(sides), 1)):.4g}")
