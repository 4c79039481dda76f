"""A camera's direction and field of view from the four corners of what it sees of the wall."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from periscopy_sim.errors import ConfigurationError
from periscopy_sim.scenario import Array


@dataclass(frozen=True, eq=False)
class Aim:
    """Where a camera looks: x and z of its target on the wall, roll, and field of view.

    Their values and standard deviations are in metres and degrees; `residual` is the root mean
    square distance of the corners from the measured ones, in metres.
    """

    values: tuple[float, ...]
    errors: tuple[float, ...]
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
    from scipy.stats import chi2

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

    def misfit(aim: Array, place: Array = position) -> Array:
        return np.asarray((corners_seen(place, distance, film, *aim) - corners).ravel() / extent)

    solution = least_squares(misfit, start, x_scale=np.array([extent, extent, 30.0, 30.0]))
    slopes = approx_fprime(position, lambda place: misfit(solution.x, place), 1e-6)
    # Corners are never known better than to a tenth of a millimetre.
    covariance = np.diag(np.maximum(corner_errors, 1e-4).ravel() ** 2) / extent**2
    covariance += (slopes * position_errors**2) @ slopes.T
    inverse = np.linalg.pinv(solution.jac)
    others = np.linalg.svd(solution.jac)[0][:, 4:]  # misfits that no aim of the camera explains
    unexplained, spread = others.T @ solution.fun, others.T @ covariance @ others
    residual = extent * float(np.sqrt(np.mean(solution.fun**2) * 2))
    if not chi2.sf(unexplained @ np.linalg.solve(spread, unexplained), 4) >= 1e-4:
        raise ConfigurationError(
            "camera: from its position it cannot see these corners: they are "
            f"{1000 * residual:.0f} mm (rms) from those of the nearest picture of square pixels; "
            "check position, corners, their order (as the camera sees them) and film"
        )
    errors = np.sqrt(np.diag(inverse @ covariance @ inverse.T))
    return Aim(tuple(solution.x.tolist()), tuple(errors.tolist()), residual)


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
