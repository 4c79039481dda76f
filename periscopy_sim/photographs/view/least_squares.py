"""A view of a plane wall by least squares over the places of marks in the photograph.

Unknown are 8 numbers of a homography, the lens's coefficients, whose number is given, and the angle
of each tag.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from periscopy_sim.errors import PhotographError
from periscopy_sim.photographs.view.homography import (
    Array,
    are_on_a_line,
    fit_homography,
    project,
)
from periscopy_sim.photographs.view.marks import Marks
from periscopy_sim.photographs.view.wall_view import WallView, distorted

ROUNDING = 1e-3
"""Pixels that a coordinate is off by rounding, at least: exact marks make no test certain."""

LINE = 0.01
"""Width of marks over their length, below which they are taken to lie on a line."""


@dataclass(frozen=True, eq=False)
class ViewFit:
    """A least-squares fit: 8 numbers of a homography, coefficients of the lens, angles of tags."""

    marks: Marks
    solution: Array
    order: int
    residuals: Array  # (n, 2) pixels
    scales: _Scales

    @property
    def squares(self) -> float:
        """Sum of squared residuals, in pixels^2, and what rounding adds to it."""
        return float(np.sum(self.residuals**2)) + ROUNDING**2 * self.residuals.size

    @property
    def freedom(self) -> int:
        """Measurements beyond the unknowns."""
        return int(self.residuals.size - self.solution.size)

    @property
    def placed(self) -> Array:
        """(n, 2) places of the marks on the wall, tags turned."""
        return self.scales.placed(self.marks, self.solution, self.order)

    @property
    def view(self) -> WallView:
        """The view that was found."""
        return self.scales.view(self.solution, self.order)

    def slopes(self, points: Array) -> Array:
        """Return (n, 2, 2) derivatives of pixels by metres across and up."""
        step = 1e-6 * self.scales.spread
        ahead = [self.view.pixels_of(points + step * axis) for axis in np.eye(2)]
        behind = [self.view.pixels_of(points - step * axis) for axis in np.eye(2)]
        return np.stack([(a - b) / (2 * step) for a, b in zip(ahead, behind, strict=True)], axis=-1)

    def standard_error(self, points: Array, error: float) -> float:
        """Return the largest standard error of where points are placed, in pixels."""

        def places(solution: Array) -> Array:
            return self.scales.view(solution, self.order).pixels_of(points).ravel()

        def marks(solution: Array) -> Array:
            return self.scales.residuals(self.marks, solution, self.order).ravel()

        by_marks = np.linalg.pinv(_derivative(marks, self.solution))
        moves = (_derivative(places, self.solution) @ by_marks).reshape(len(points), -1)
        return float(error * np.sqrt(np.sum(moves**2, axis=1).max()))


@dataclass(frozen=True, eq=False)
class _Scales:
    """Coordinates in which every unknown is about 1: about the marks, and about the lens's axis."""

    origin: Array
    spread: float
    center: Array
    radius: float

    def homography(self, solution: Array) -> Array:
        shrink = np.array([[1, 0, -self.origin[0]], [0, 1, -self.origin[1]], [0, 0, self.spread]])
        enlarge = np.array(
            [[self.radius, 0, self.center[0]], [0, self.radius, self.center[1]], [0, 0, 1]]
        )
        return np.asarray(enlarge @ np.append(solution[:8], 1).reshape(3, 3) @ shrink)

    def unknowns(self, homography: Array) -> Array:
        enlarge = np.array(
            [[self.spread, 0, self.origin[0]], [0, self.spread, self.origin[1]], [0, 0, 1]]
        )
        shrink = np.array([[1, 0, -self.center[0]], [0, 1, -self.center[1]], [0, 0, self.radius]])
        scaled = (shrink @ homography @ enlarge).ravel()
        return np.asarray(scaled[:8] / scaled[8])

    def view(self, solution: Array, order: int) -> WallView:
        distortion = tuple(float(k) for k in solution[8 : 8 + order])
        return WallView(self.homography(solution), self.center, self.radius, distortion)

    def placed(self, marks: Marks, solution: Array, order: int) -> Array:
        angles = np.zeros(len(marks))
        if marks.arms.any():
            angles = solution[8 + order :]
        cos, sin = np.cos(angles)[marks.owner], np.sin(angles)[marks.owner]
        x, y = marks.arms.T
        turned = np.stack([cos * x - sin * y, sin * x + cos * y], axis=1)
        return np.asarray(marks.anchors + turned)

    def residuals(self, marks: Marks, solution: Array, order: int) -> Array:
        places = self.placed(marks, solution, order)
        from_center = project(np.append(solution[:8], 1).reshape(3, 3),
                              (places - self.origin) / self.spread)  # fmt: skip
        shown = self.center + self.radius * distorted(from_center, solution[8 : 8 + order])
        return np.asarray(shown - marks.pixels)


def least_squares_view(marks: Marks, size: tuple[int, int], order: int) -> ViewFit:
    """Return the view of least squares with so many coefficients of the lens.

    The photograph's size is (rows, columns). A `PhotographError` says that no view shows the marks
    so.
    """
    from scipy.optimize import least_squares

    origin = marks.anchors.mean(axis=0)
    spread = float(np.linalg.norm(marks.anchors - origin, axis=1).mean())
    rows, columns = size
    scales = _Scales(
        origin, spread, np.array([columns / 2, rows / 2]), float(np.hypot(columns, rows) / 2)
    )
    try:
        homography, angles = _start(marks)
        start = np.concatenate([scales.unknowns(homography), np.zeros(order), angles])
        found = least_squares(
            lambda solution: scales.residuals(marks, solution, order).ravel(),
            start, method="lm", xtol=1e-13, ftol=1e-13, gtol=1e-13,
        )  # fmt: skip
    except (ValueError, np.linalg.LinAlgError):  # a horizon through the marks, or no homography
        raise PhotographError(
            "no view of a plane wall shows the marks so; look at their order, and at each number"
        ) from None
    return ViewFit(marks, found.x, order, found.fun.reshape(-1, 2), scales)


def _start(marks: Marks) -> tuple[Array, Array]:
    """Return a homography and the angles of tags to begin with; of points there are no angles."""
    if not marks.arms.any():
        return fit_homography(marks.anchors, marks.pixels), np.zeros(0)
    # The tag that is seen largest tells the view but for its own turn; the other tags tell that.
    middles = marks.centers()
    corners, arms = marks.pixels.reshape(-1, 4, 2), marks.arms.reshape(-1, 4, 2)
    largest = int(np.argmax(np.linalg.norm(corners[:, 2] - corners[:, 0], axis=1)))
    seen = np.linalg.inv(fit_homography(arms[largest], corners[largest]))
    offsets = project(seen, middles.pixels) @ np.array([1, 1j])
    expected = (middles.anchors - middles.anchors[largest]) @ np.array([1, 1j])
    turn = np.angle(np.sum(expected * offsets.conj()))
    on_wall = (arms[largest] @ np.array([1, 1j])) * np.exp(1j * turn)
    homography = fit_homography(
        middles.anchors[largest] + np.stack([on_wall.real, on_wall.imag], axis=1), corners[largest]
    )
    if len(middles) >= 4 and not are_on_a_line(middles.anchors, 10 * LINE):
        homography = fit_homography(middles.anchors, middles.pixels)
    back = project(np.linalg.inv(homography), corners.reshape(-1, 2)).reshape(-1, 4, 2)
    turned = (back - middles.anchors[:, np.newaxis]) @ np.array([1, 1j])
    angles = np.angle(np.sum(turned * (arms @ np.array([1, 1j])).conj(), axis=1))
    return homography, angles


def _derivative(function: object, at: Array) -> Array:
    """Return the derivative of a vector function, by central differences."""
    assert callable(function)
    steps = 1e-6 * np.eye(len(at))
    return np.stack([(function(at + step) - function(at - step)) / 2e-6 for step in steps], axis=1)
