"""A camera's direction and field of view from the four corners of what it sees of the wall."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np

from periscopy_sim.errors import ConfigurationError
from periscopy_sim.scenario import Array

LIKELY = 23.5
"""Sum of squared deviations of 4 degrees of freedom that chance exceeds once in 10,000 times."""

SHARPEST = 1e-4
"""Least standard deviation of a corner, in metres."""

NAMES = ("target_x", "target_z", "camera_roll", "field_of_view")


@dataclass(frozen=True, eq=False)
class Aim:
    """Where a camera looks, after `NAMES`: values and standard deviations, metres and degrees.

    `residual` is the root mean square distance of the corners from the measured ones, in metres.
    """

    values: Mapping[str, float]
    errors: Mapping[str, float]
    residual: float


def aim_at_corners(
    position: Array,
    distance: float,
    corners: Array,
    film: tuple[int, int],
    position_errors: Array,
    corner_errors: Array,
) -> Aim:
    """Return the direction, roll and field of view whose picture has these corners.

    Parameters
    ----------
    position
        (3,) of the camera, metres; its errors are standard deviations, (3,).
    distance
        y of the wall.
    corners
        (4, 2) x and z of the wall's points in the picture's corners, as the camera sees them: top
        left, top right, bottom right, bottom left; their errors are (4, 2).
    film
        (rows, columns) of square pixels.

    Raises
    ------
    ConfigurationError
        If no camera there sees these corners, to within the errors.
    """
    from scipy.optimize import approx_fprime, least_squares

    a, b, c, d = corners
    sides = np.stack([c - a, b - d], axis=1)
    if abs(np.linalg.det(sides)) < 1e-9:
        raise ConfigurationError("camera.corners: they lie on a line; measure them again")
    middle = a + np.linalg.solve(sides, b - a)[0] * (c - a)  # where the diagonals cross
    extent = float(np.linalg.norm(corners - middle, axis=1).mean())
    away = float(np.linalg.norm(np.insert(middle, 1, distance) - position))
    rightwards = corners[1] + corners[2] - corners[0] - corners[3]
    roll = -np.degrees(np.arctan2(rightwards[1], rightwards[0]))
    start = np.array([*middle, roll, 2 * np.degrees(np.arctan(extent / away))])
    scale = np.array([extent, extent, 30.0, 30.0])

    def misfit(values: Array) -> Array:
        seen = corners_seen(position, distance, film, *values)
        return np.asarray((seen - corners).ravel() / extent)

    solution = least_squares(misfit, start, x_scale=scale)
    misfits = misfit(solution.x) * extent
    slopes = approx_fprime(
        position, lambda moved: corners_seen(moved, distance, film, *solution.x).ravel(), 1e-6
    )
    covariance = np.diag(np.maximum(corner_errors, SHARPEST).ravel() ** 2)
    covariance += (slopes * position_errors**2) @ slopes.T
    J = solution.jac * extent
    inverse = np.linalg.pinv(J)
    others = np.linalg.svd(J)[0][:, J.shape[1] :]  # misfits that no aim of the camera explains
    unexplained = others.T @ misfits
    spread = others.T @ covariance @ others
    residual = float(np.sqrt(np.mean(misfits**2) * 2))
    if not unexplained @ np.linalg.solve(spread, unexplained) < LIKELY:
        raise ConfigurationError(
            "camera: from its position it cannot see these corners: they are "
            f"{1000 * residual:.0f} mm (rms) from those of the nearest picture of square pixels; "
            "check position, corners, their order (as the camera sees them) and film"
        )
    errors = np.sqrt(np.diag(inverse @ covariance @ inverse.T))
    named = dict(zip(NAMES, map(float, solution.x), strict=True))
    return Aim(named, dict(zip(NAMES, map(float, errors), strict=True)), residual)


def corners_seen(
    position: Array,
    distance: float,
    film: tuple[int, int],
    target_x: float,
    target_z: float,
    roll: float,
    field_of_view: float,
) -> Array:
    """Return x and z of the wall's points in the corners of a pinhole camera's picture, (4, 2).

    The wall is y = `distance`. The field of view, in degrees, is that of the picture's width; a
    positive roll turns the camera clockwise as it looks. The order is that of `aim_at_corners`. A
    `ConfigurationError` says that the picture does not end on the wall.
    """
    ahead = np.array([target_x, distance, target_z]) - position
    ahead /= np.linalg.norm(ahead)
    right = np.cross(ahead, [0.0, 0.0, 1.0])
    right /= np.linalg.norm(right)
    up = np.cross(right, ahead)
    c, s = np.cos(np.radians(roll)), np.sin(np.radians(roll))
    right, up = c * right - s * up, s * right + c * up
    half = np.tan(np.radians(field_of_view) / 2)
    tall = half * film[0] / film[1]
    rays = ahead + np.array([[-half], [half], [half], [-half]]) * right
    rays += np.array([[tall], [tall], [-tall], [-tall]]) * up
    if rays[:, 1].min() <= 1e-3 * np.linalg.norm(rays, axis=1).max():
        raise ConfigurationError(
            "camera: a corner of its picture shows what is beyond the wall's horizon; turn it more "
            "towards the wall, or make its field of view smaller"
        )
    reach = (distance - position[1]) / rays[:, 1:2]
    return np.asarray((position + reach * rays)[:, [0, 2]])
