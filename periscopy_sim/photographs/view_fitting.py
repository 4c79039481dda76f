"""The view of a wall found from marks on it: points, or square tags of unknown turn.

Least squares over what was clicked or detected in the photograph. How many coefficients of the
lens are found, and whether a mark is wrong, is decided by F tests of nested models: what a further
coefficient, or leaving a mark out, takes off the sum of squares is compared with what is left.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray

from periscopy_sim.errors import PhotographError
from periscopy_sim.photographs.homography import (
    Array,
    are_on_a_line,
    fit_homography,
    project,
)
from periscopy_sim.photographs.wall_view import WallView, distorted

SIGNIFICANCE = 0.01
"""Rate at which a lens without distortion is given a coefficient, and right marks a bad one."""

MOST_COEFFICIENTS = 2
FEWEST_FREE = 4
"""Measurements beyond the unknowns, that a fit with distortion must leave."""

ROUNDING = 1e-3
"""Pixels that a coordinate is off by rounding, at least: exact marks make no test certain."""

ASSUMED = 0.5
"""Pixels that a mark's coordinate is taken to be off, where nothing is left to tell it."""

LINE = 0.01
"""Width of marks over their length, below which they are taken to lie on a line."""


@dataclass(frozen=True, eq=False)
class Marks:
    """Marks on a plane wall and where a photograph shows them.

    A point has one place; a square tag four, its corners, which are turned by an unknown angle.

    Attributes
    ----------
    pixels
        (n, 2) column and row.
    anchors
        (n, 2) metres across and up of the point, or of the tag's centre.
    arms
        (n, 2) metres from the centre to the corner of a tag that is not turned; 0 of a point.
    owner
        (n,) which mark each place belongs to, from 0 on, in order.
    names
        What messages call each mark.
    """

    pixels: Array
    anchors: Array
    arms: Array
    owner: NDArray[np.int64]
    names: Sequence[str]

    def __len__(self) -> int:
        """Return the number of marks."""
        return len(self.names)

    def without(self, mark: int) -> Marks:
        """Return all marks but one."""
        kept = self.owner != mark
        owner = self.owner[kept]
        names = [name for k, name in enumerate(self.names) if k != mark]
        return Marks(
            self.pixels[kept], self.anchors[kept], self.arms[kept], owner - (owner > mark), names
        )

    def centers(self) -> Marks:
        """Return the marks as points: of each tag the middle, where its diagonals meet."""
        if not self.arms.any():
            return self
        pixels, anchors = [], []
        for mark in range(len(self)):
            own = self.owner == mark
            middle = self.pixels[own][:1]
            if self.arms[own].any():
                local = fit_homography(self.arms[own], self.pixels[own])
                middle = project(local, np.zeros((1, 2)))
            pixels.append(middle[0])
            anchors.append(self.anchors[own][0])
        return points_as_marks(np.array(pixels), np.array(anchors), self.names)


def points_as_marks(pixels: Array, points: Array, names: Sequence[str]) -> Marks:
    """Return (n, 2) pixels and their (n, 2) points of the wall, in metres, as marks."""
    return Marks(pixels, points, np.zeros_like(points), np.arange(len(points)), names)


def tags_as_marks(corners: Array, centers: Array, sizes: Array, names: Sequence[str]) -> Marks:
    """Return square tags as marks.

    Parameters
    ----------
    corners
        (n, 4, 2) column and row of the corners, in order around each tag, clockwise as a viewer
        sees them.
    centers
        (n, 2) metres across and up.
    sizes
        (n,) sides in metres.
    names
        What messages call them.
    """
    unit = np.array([[-0.5, 0.5], [0.5, 0.5], [0.5, -0.5], [-0.5, -0.5]])
    arms = sizes[:, np.newaxis, np.newaxis] * unit
    return Marks(
        corners.reshape(-1, 2),
        np.repeat(centers, 4, axis=0),
        arms.reshape(-1, 2),
        np.repeat(np.arange(len(sizes)), 4),
        names,
    )


@dataclass(frozen=True, eq=False)
class FittedView:
    """A view of the wall, and how well it is known.

    Attributes
    ----------
    view
        Where the photograph shows each point of the wall.
    marks
        What it was found from.
    residuals
        (n,) distances in pixels between where each place of the marks is and should be.
    residuals_on_wall
        (n,) the same in metres on the wall.
    freedom
        Measurements beyond the unknowns; where it is 0 the residuals tell nothing.
    error
        Standard deviation of a coordinate of a mark, in pixels: as the residuals have it, or
        `ASSUMED` where they tell nothing.
    corners
        (k, 2) corners of tags in metres across and up, as they were found to be turned; else empty.
    """

    view: WallView
    marks: Marks = field(repr=False)
    residuals: Array = field(repr=False)
    residuals_on_wall: Array = field(repr=False)
    freedom: int
    error: float
    corners: Array = field(repr=False)
    _fit: _Fit = field(repr=False)

    def standard_error(self, points: Array) -> float:
        """Return the largest standard error, in pixels, with which (n, 2) points are placed."""
        return self._fit.standard_error(points, self.error)


def fit_view(marks: Marks, size: tuple[int, int]) -> FittedView:
    """Find the view of a plane wall from marks.

    Distortion is added, k1 and then k2, where that explains the marks better at `SIGNIFICANCE`, and
    at least `FEWEST_FREE` measurements are left over.

    Parameters
    ----------
    marks
        Four points or two tags, or more; not on a line.
    size
        (rows, columns) of the photograph.

    Returns
    -------
    FittedView

    Raises
    ------
    PhotographError
        If they are too few, lie on a line, make the photograph a mirror image, or one of them does
        not agree with the others: by an F test of leaving it out, at `SIGNIFICANCE` for all of them
        together (Bonferroni), from six marks on.
    """
    _check_enough(marks)
    points = marks.centers()
    order = _coefficients(points, size)
    _check_each(points, size, order)
    fit = _fitted(marks, size, order)
    residuals = np.linalg.norm(fit.residuals, axis=1)
    slopes = fit.slopes(fit.placed)
    on_wall = np.linalg.norm(
        np.linalg.solve(slopes, fit.residuals[..., np.newaxis])[..., 0], axis=1
    )
    if (np.linalg.det(slopes) > 0).any():  # rows run down, the wall's up runs up
        raise PhotographError(
            "the marks make the photograph a mirror image of the wall; look at the order of column "
            "and row, and at the signs of x, y and z"
        )
    error = np.sqrt(fit.squares / fit.freedom) if fit.freedom else ASSUMED
    turned = fit.placed[marks.arms.any(axis=1)]
    return FittedView(fit.view, marks, residuals, on_wall, fit.freedom, float(error), turned, fit)


def _check_enough(marks: Marks) -> None:
    tags = bool(marks.arms.any())
    if len(marks) < (2 if tags else 4):
        least, kind = ("two tags", "tags") if tags else ("four points", "points")
        raise PhotographError(f"{len(marks)} {kind} do not tell the view; give at least {least}")
    points = marks.centers()
    for places, where in ((points.anchors, "on the wall"), (points.pixels, "in the photograph")):
        if are_on_a_line(places, LINE) and not tags:
            raise PhotographError(
                f"the points lie on a line {where}, or nearly; measure some beside it"
            )
        distance = np.linalg.norm(places[:, np.newaxis] - places, axis=2)
        np.fill_diagonal(distance, np.inf)
        if distance.min() <= 0:
            i, j = np.unravel_index(distance.argmin(), distance.shape)
            raise PhotographError(
                f"{points.names[i]} and {points.names[j]} are at the same place {where}; measure "
                "another point"
            )
    if tags:
        return
    for left_out in range(len(points)):
        others = points.without(left_out)
        if are_on_a_line(others.anchors, LINE):
            raise PhotographError(
                f"all points but {points.names[left_out]} lie on a line, or nearly; measure more "
                "beside it"
            )


# -- least squares -------------------------------------------------------------------------------


@dataclass(frozen=True, eq=False)
class _Fit:
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


def _fitted(marks: Marks, size: tuple[int, int], order: int) -> _Fit:
    """Fit a view with so many coefficients of the lens."""
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
    return _Fit(marks, found.x, order, found.fun.reshape(-1, 2), scales)


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


# -- tests ---------------------------------------------------------------------------------------


def _p_value(simple: _Fit, rich: _Fit) -> float:
    """Return how likely chance alone takes as much off the squares as the richer fit does.

    The simpler fit has more unknowns fixed, or a mark more to explain. The ratio of what is taken
    off to what is left, each for a degree of freedom, has the F distribution.
    """
    from scipy.special import fdtrc

    more = simple.freedom - rich.freedom
    gained = max(simple.squares - rich.squares, 0) / more
    return float(fdtrc(more, rich.freedom, gained / (rich.squares / rich.freedom)))


def _coefficients(points: Marks, size: tuple[int, int]) -> int:
    """Return how many coefficients of the lens the points show."""
    order = 0
    while order < MOST_COEFFICIENTS and 2 * len(points) - (9 + order) >= FEWEST_FREE:
        if _p_value(_fitted(points, size, order), _fitted(points, size, order + 1)) > SIGNIFICANCE:
            break
        order += 1
    return order


def _check_each(points: Marks, size: tuple[int, int], order: int) -> None:
    """Refuse a point that does not agree with the others."""
    count = len(points)
    if 2 * (count - 1) <= 8 + order:
        return
    whole = _fitted(points, size, order)
    rest = [_fitted(points.without(k), size, order) for k in range(count)]
    chances = [_p_value(whole, each) for each in rest]
    worst = int(np.argmin(chances))
    if chances[worst] * count >= SIGNIFICANCE:
        return
    off = rest[worst].view.pixels_of(points.anchors[worst : worst + 1]) - points.pixels[worst]
    column, row = points.pixels[worst]
    raise PhotographError(
        f"{points.names[worst]} at column {column:.1f}, row {row:.1f} lies {np.hypot(*off[0]):.1f} "
        f"pixels from where the other {count - 1} place it (their own error is "
        f"{np.sqrt(rest[worst].squares / rest[worst].freedom):.2f}); measure it again, or leave it "
        "out"
    )
