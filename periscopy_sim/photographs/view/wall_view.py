"""Where a photograph shows each point of a plane wall, and where the scene's camera does."""

from __future__ import annotations

from dataclasses import dataclass, field

import numpy as np

from periscopy_sim.errors import SceneError
from periscopy_sim.photographs.view.homography import Array, depths, fit_homography, project
from periscopy_sim.scenario import Scenario, WallFrame, wall_frame

FLATNESS = 1e-3
"""Part of a film pixel's size that wall points may lie off a plane, or off a perspective view."""

_SAMPLED = 16  # pixels along each side of the film that its homography is fitted to


@dataclass(frozen=True, eq=False)
class WallView:
    """The view of a plane through a lens: a homography, then radial distortion.

    A point q = `homography` (u, v, 1) of the undistorted picture appears at
    c + (q - c) (1 + k1 r^2 + k2 r^4), where r is its distance from the centre c over `radius`
    (Brown 1966, without decentring).

    Attributes
    ----------
    homography
        (3, 3), from metres in the plane to columns and rows of pixels; the first pixel's centre is
        at (0.5, 0.5).
    center
        (2,) column and row of the lens's axis, in pixels.
    radius
        Half of the picture's diagonal, in pixels.
    distortion
        k1, k2; none or the first alone where the lens is taken to have no more.
    """

    homography: Array = field(repr=False)
    center: Array
    radius: float
    distortion: tuple[float, ...] = ()

    def pixels_of(self, points: Array) -> Array:
        """Return column and row in the photograph of (n, 2) points of the plane, in metres."""
        from_center = (project(self.homography, points) - self.center) / self.radius
        return self.center + self.radius * distorted(from_center, self.distortion)

    def shows(self, points: Array) -> bool:
        """Return whether points lie ahead of the camera, and its lens does not fold the picture."""
        if not (depths(self.homography, points) > 0).all():
            return False
        from_center = (project(self.homography, points) - self.center) / self.radius
        square = np.sum(from_center**2, axis=1)
        slope = 1 + sum((2 * n + 3) * k * square ** (n + 1) for n, k in enumerate(self.distortion))
        return bool(np.all(slope > 0))


def distorted(points: Array, distortion: tuple[float, ...] | Array) -> Array:
    """Return (n, 2) points about a lens's axis where it shows them; see `WallView`."""
    square = np.sum(points**2, axis=1, keepdims=True)
    factor = 1 + sum(k * square ** (n + 1) for n, k in enumerate(distortion))
    return np.asarray(points * factor)


@dataclass(frozen=True, eq=False)
class WallPlane:
    """A scene's plane wall: its frame, and where the film's pixels lie in it.

    `film` is the (3, 3) homography from columns and rows of the film, whose first pixel's centre is
    at (0.5, 0.5), to metres across and up in the frame.
    """

    frame: WallFrame
    shape: tuple[int, int]
    film: Array = field(repr=False)

    def coordinates(self, points: Array) -> Array:
        """Return (n, 2) metres across and up of (n, 3) points; what is off the plane is dropped."""
        return (points - self.frame.center) @ np.stack([self.frame.across, self.frame.up], axis=1)

    def heights(self, points: Array) -> Array:
        """Return (n,) metres of (n, 3) points ahead of the plane, towards the camera."""
        return np.asarray((points - self.frame.center) @ self.frame.normal)

    def pixel_corners(self) -> Array:
        """Return ((rows + 1) (columns + 1), 2) corners of the film's pixels in the plane."""
        rows, columns = self.shape
        row, column = np.divmod(np.arange((rows + 1) * (columns + 1)), columns + 1)
        return project(self.film, np.stack([column, row], axis=1).astype(np.float64))

    def pixels_of(self, points: Array) -> Array:
        """Return column and row on the film of (n, 2) points of the plane."""
        return project(np.linalg.inv(self.film), points)


def wall_plane(scenario: Scenario) -> WallPlane:
    """Return the plane of a scene's wall.

    A wall that is not plane, a camera that does not see straight lines straight, and a film of
    fewer than 2 x 2 pixels are a `SceneError`.
    """
    rows, columns = scenario.photograph_shape
    where = f"scene '{scenario.path}'"
    if min(rows, columns) < 2:
        raise SceneError(f"{where}: the film has {rows}x{columns} pixels; give it 2x2 at least")
    frame = wall_frame(scenario.wall_points, scenario.wall_normals, scenario.photograph_shape)
    points = scenario.wall_points - frame.center
    plane = points @ np.stack([frame.across, frame.up], axis=1)
    grid = plane.reshape(rows, columns, 2)
    size = np.linalg.norm(np.diff(grid, axis=1), axis=2).mean()
    off = np.abs(points @ frame.normal).max()
    if off > FLATNESS * size + 1e-6 * np.abs(points).max():
        raise SceneError(
            f"{where}: the wall is curved (it leaves a plane by {1e3 * off:.3g} mm), and points "
            "rectify a plane wall alone; let the scene's camera be the photograph's, without points"
        )
    sampled = np.ix_(*(np.unique(np.linspace(0, n - 1, _SAMPLED).round()).astype(int)
                       for n in (rows, columns)))  # fmt: skip
    row, column = np.indices((rows, columns)) + 0.5
    film = np.stack([column, row], axis=-1)
    homography = fit_homography(film[sampled].reshape(-1, 2), grid[sampled].reshape(-1, 2))
    misfit = np.abs(project(homography, film.reshape(-1, 2)) - plane).max()
    if misfit > 10 * (FLATNESS * size + 1e-6 * np.abs(points).max()):
        raise SceneError(
            f"{where}: its camera does not show straight lines straight; rectify into a "
            "perspective or orthographic one"
        )
    return WallPlane(frame, (rows, columns), homography)
