"""The map from points of a plane wall to a photograph, and to the film of the scene's camera."""

from dataclasses import dataclass, field, replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from periscopy_sim.errors import SceneError
from periscopy_sim.geometry import Geometry
from periscopy_sim.numerics import Array
from periscopy_sim.view import WallFrame

FLATNESS = 1e-3
"""Distance of wall points from a plane, over a film pixel's size, that counts as flat."""


def project(homography: NDArray[np.floating[Any]], points: Array) -> Array:
    """Return (n, 2) points of a plane where a (3, 3) homography sends them."""
    image = points @ homography[:, :2].T + homography[:, 2]
    return np.asarray(image[:, :2] / image[:, 2:])


def fit_homography(source: Array, target: Array) -> Array:
    """Return the (3, 3) homography that sends (n, 2) source points to target points, n >= 4.

    This is the normalized direct linear transform (Hartley and Zisserman, *Multiple View Geometry*,
    2nd edition, algorithm 4.2), exact for exact points. The homography has norm 1, and its third
    coordinate is positive at the source's centroid.
    """
    before, after = _normalizing(source), _normalizing(target)
    x, y = project(before, source), project(after, target)
    # y ~ H x: (h1 - y1 h3)·x = 0 and (h2 - y2 h3)·x = 0 of the rows h of H. The null vector of
    # these rows is H; their R alone has it too, at 9 x 9 whatever the number of points.
    rows = np.zeros((2 * len(x), 9))
    rows[0::2, 0:3] = rows[1::2, 3:6] = np.column_stack([x, np.ones(len(x))])
    rows[0::2, 6:9] = -y[:, :1] * rows[0::2, 0:3]
    rows[1::2, 6:9] = -y[:, 1:] * rows[1::2, 3:6]
    normalized = np.linalg.svd(np.linalg.qr(rows, mode="r"))[2][-1].reshape(3, 3)
    homography = np.linalg.solve(after, normalized @ before)
    homography *= np.sign(homography[2] @ [*source.mean(axis=0), 1]) or 1
    return np.asarray(homography / np.linalg.norm(homography))


def similarity(center: Array, scale: float) -> Array:
    """Return the (3, 3) homography that subtracts a (2,) centre and divides by a scale."""
    return np.array([[1, 0, -center[0]], [0, 1, -center[1]], [0, 0, scale]]) / scale


def _normalizing(points: Array) -> Array:
    """Return the similarity that centres points and makes their mean distance sqrt(2)."""
    distance = np.linalg.norm(points - points.mean(axis=0), axis=1).mean()
    return similarity(points.mean(axis=0), distance / np.sqrt(2) or 1.0)


@dataclass(frozen=True, eq=False)
class WallView:
    """The view of a plane through a lens: a homography, then radial distortion.

    A point q = `homography` (u, v, 1) of the undistorted picture, in columns and rows of pixels of
    which the first has its centre at (0.5, 0.5), appears at c + (q - c) (1 + k1 r^2 + k2 r^4),
    where r is its distance from the centre c over `radius` (Brown 1966, without decentring).
    """

    homography: Array = field(repr=False)  # (3, 3), of metres in the plane
    center: Array  # (2,) column and row of the lens's axis, in pixels
    radius: float  # half of the picture's diagonal, in pixels
    distortion: tuple[float, ...] = ()  # (k1, k2), (k1,) or ()

    def pixels_of(self, points: Array) -> Array:
        """Return column and row in the photograph of (n, 2) points of the plane, in metres."""
        offset, square = self._from_axis(points)
        factor = 1 + sum(k * square ** (n + 1) for n, k in enumerate(self.distortion))
        return np.asarray(self.center + offset * factor)

    def shows(self, points: Array) -> bool:
        """Return whether points lie ahead of the camera, and its lens does not fold the picture."""
        if (points @ self.homography[2, :2] + self.homography[2, 2] <= 0).any():
            return False
        square = self._from_axis(points)[1]
        # d/dr of r (1 + k1 r² + k2 r⁴): where it is not positive, the picture folds back.
        slope = 1 + sum((2 * n + 3) * k * square ** (n + 1) for n, k in enumerate(self.distortion))
        return bool(np.all(slope > 0))

    def _from_axis(self, points: Array) -> tuple[Array, Array]:
        """Return (n, 2) undistorted offsets from the axis, and r^2, (n, 1)."""
        offset = project(self.homography, points) - self.center
        return offset, np.sum((offset / self.radius) ** 2, axis=1, keepdims=True)


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
        """Return (n, 3) metres across, up and ahead, towards the camera, of (n, 3) points."""
        axes = np.stack([self.frame.across, self.frame.up, self.frame.normal], axis=1)
        return (points - self.frame.center) @ axes

    def pixel_corners(self) -> Array:
        """Return ((rows + 1) (columns + 1), 2) corners of the film's pixels in the plane."""
        rows, columns = self.shape
        row, column = np.indices((rows + 1, columns + 1)).reshape(2, -1)
        return project(self.film, np.stack([column, row], axis=1).astype(np.float64))


def wall_plane(scenario: Geometry) -> WallPlane:
    """Return the plane of a scene's wall.

    A wall that is not plane, a camera that does not show straight lines straight, and a film of
    fewer than 2 x 2 pixels are a SceneError.
    """
    shape = scenario.photograph_shape
    where = f"scene '{scenario.path}'"
    if min(shape) < 2:
        raise SceneError(f"{where}: the film has {shape[0]}x{shape[1]} pixels; give it 2x2")
    points = scenario.view.centers
    plane = WallPlane(scenario.view.frame, shape, np.eye(3))
    across, up, ahead = plane.coordinates(points).T
    on_wall = np.stack([across, up], axis=1)
    pixel = np.linalg.norm(np.diff(on_wall.reshape(*shape, 2), axis=1), axis=2).mean()
    tolerance = FLATNESS * pixel + 1e-6 * np.abs(on_wall).max()
    if (off := np.abs(ahead).max()) > tolerance:
        raise SceneError(
            f"{where}: the wall is curved (it leaves a plane by {1e3 * off:.3g} mm), and marks "
            "rectify a plane wall alone; let the scene's camera be the photograph's, without marks"
        )
    film = np.indices(shape).reshape(2, -1).T[:, ::-1] + np.float64(0.5)  # column and row
    some = np.arange(len(film)).reshape(shape)[:: 1 + shape[0] // 16, :: 1 + shape[1] // 16].ravel()
    homography = fit_homography(film[some], on_wall[some])
    if np.abs(project(homography, film) - on_wall).max() > 10 * tolerance:
        raise SceneError(
            f"{where}: its camera does not show straight lines straight; rectify into a "
            "perspective or orthographic one"
        )
    return replace(plane, film=homography)
