"""The view of a wall fitted to marks on it: points, or square tags of unknown turn.

Least squares over the marks' places in the photograph. F tests of nested models decide how many
coefficients of the lens are fitted, and whether a mark is wrong: they compare what a further
coefficient, or one mark less, takes off the sum of squares with the rest of that sum.
"""

from collections.abc import Callable
from dataclasses import dataclass, field

import numpy as np

from periscopy_sim.errors import PhotographError
from periscopy_sim.numerics import Array
from periscopy_sim.photographs.marks import Marks
from periscopy_sim.photographs.wall_view import WallView, fit_homography, project, similarity

SIGNIFICANCE = 0.01
"""Rate at which a lens without distortion gets a coefficient, and right marks a bad one."""

MOST_COEFFICIENTS = 2
FEWEST_FREE = 4
"""Measurements beyond the unknowns that a fit with distortion must leave."""

CLICK_ERROR = 0.5
"""Error of a mark's coordinate in the photograph, in pixels, where no residual shows it."""

COORDINATE_ROUNDING = 1e-3
"""Error of any coordinate in the photograph, in pixels: exact marks make no test certain."""

LINE_WIDTH = 0.01
"""Width of marks over their length up to which they count as a line."""


@dataclass(frozen=True, eq=False)
class FittedView:
    """A view of the wall by least squares, with its errors.

    Without freedom, measurements beyond the unknowns, the residuals show nothing.
    """

    marks: Marks = field(repr=False)  # as they were given
    view: WallView
    places: Array = field(repr=False)  # (n, p, 2) of the marks on the wall, tags turned
    residuals: Array = field(repr=False)  # (n p, 2) pixels from the photograph's to the view's
    freedom: int
    _moves: Callable[[Array | None], Array] = field(repr=False)  # of points or marks, per unknown

    @property
    def squares(self) -> float:
        """Sum of squared residuals, in pixels^2, and what rounding adds to it."""
        return float(np.sum(self.residuals**2)) + COORDINATE_ROUNDING**2 * self.residuals.size

    @property
    def error(self) -> float:
        """Standard deviation of a mark's coordinate, in pixels; `CLICK_ERROR` without freedom."""
        return float(np.sqrt(self.squares / self.freedom)) if self.freedom else CLICK_ERROR

    @property
    def rms(self) -> float:
        """Root mean square of the residuals' lengths, in pixels."""
        return float(np.sqrt(2 * np.mean(self.residuals**2)))

    @property
    def rms_on_wall(self) -> float:
        """The same in metres on the wall."""
        on_wall = np.linalg.solve(self.slopes(), self.residuals[..., np.newaxis])
        return float(np.sqrt(2 * np.mean(on_wall**2)))

    def record(self, placement: float) -> dict[str, object]:
        """Return the numbers of the view, and the error with which it places, for metadata."""
        return {
            "view_placement": placement,
            "view_residual_pixels": self.rms,
            "view_distortion": " ".join(map(repr, self.view.distortion)) or "none",
            "view_homography": " ".join(map(repr, self.view.homography.ravel().tolist())),
        }

    def slopes(self) -> Array:
        """Return (n p, 2, 2) derivatives of pixels by metres across and up, at the marks."""
        places = self.places.reshape(-1, 2)
        size = float(np.ptp(places, axis=0).max())
        moved = _derivative(lambda step: self.view.pixels_of(places + size * step), np.zeros(2))
        return np.asarray(moved.reshape(-1, 2, 2) / size)

    def standard_error(self, points: Array) -> float:
        """Return the largest standard error, in pixels, with which (n, 2) points are placed."""
        # Of the fit's unknowns x, dx = J⁺ e of errors e in the marks' pixels, so that a point moves
        # by (dp/dx) J⁺ e: the rows' squares are variances for errors of variance 1.
        moves = self._moves(points) @ np.linalg.pinv(self._moves(None))
        squares = np.sum(moves.reshape(len(points), -1) ** 2, axis=1)
        return float(self.error * np.sqrt(squares.max()))


def fit_view(marks: Marks, size: tuple[int, int]) -> FittedView:
    """Return the view of a plane wall that fits marks best, in a photograph of (rows, columns).

    Distortion is added, k1 and then k2, where it explains the marks better at `SIGNIFICANCE` and
    leaves at least `FEWEST_FREE` measurements. A PhotographError names marks that are too few (four
    points or two tags are needed), lie on a line, make the photograph a mirror image, or disagree
    with the others: by an F test of leaving one out, at `SIGNIFICANCE` for all of them together
    (Bonferroni), from six marks on.
    """
    least, kind = (2, "tags") if marks.are_tags else (4, "points")
    if len(marks) < least:
        raise PhotographError(f"{len(marks)} {kind} do not show the view; give at least {least}")
    points = marks.as_points()
    for k in range(len(points) if kind == "points" else 0):
        others = points.without(k)
        if _on_a_line(others.centers) or _on_a_line(others.pixels[:, 0]):
            raise PhotographError(
                f"all points, or all but {points.names[k]}, lie on a line, or nearly; measure more "
                "beside it"
            )
    order = _coefficients(points, size)
    _check_each(points, size, order)
    fit = _least_squares(marks, size, order)
    if (np.linalg.det(fit.slopes()) > 0).any():  # rows run down, the wall's up runs up
        raise PhotographError(
            "the marks make the photograph a mirror image of the wall; look at the order of column "
            "and row, and at the signs of x, y and z"
        )
    return fit


def _least_squares(marks: Marks, size: tuple[int, int], order: int) -> FittedView:
    """Return the view of least squares with `order` coefficients of the lens.

    Unknown are 8 numbers of a homography, the lens's coefficients, and the angle of each tag. The
    homography is that from the wall about the marks to the picture about the lens's axis, which
    makes each unknown about 1.
    """
    from scipy.optimize import least_squares

    rows, columns = size
    center, radius = np.array([columns / 2, rows / 2]), float(np.hypot(columns, rows) / 2)
    origin = marks.centers.mean(axis=0)
    wall = similarity(origin, np.linalg.norm(marks.centers - origin, axis=1).mean() or 1.0)
    picture = similarity(center, radius)

    def view_of(solution: Array) -> WallView:
        scaled = np.append(solution[:8], 1).reshape(3, 3)
        homography = np.linalg.solve(picture, scaled @ wall)
        return WallView(
            np.asarray(homography), center, radius, tuple(map(float, solution[8 : 8 + order]))
        )

    def places_of(solution: Array) -> Array:
        return marks.turned(solution[8 + order :] if marks.are_tags else np.zeros(len(marks)))

    def pixels_of(solution: Array, points: Array | None = None) -> Array:
        on_wall = places_of(solution).reshape(-1, 2) if points is None else points
        return view_of(solution).pixels_of(on_wall)

    def residuals(solution: Array) -> Array:
        return (pixels_of(solution) - marks.pixels.reshape(-1, 2)).ravel()

    try:
        homography, angles = _start(marks)
        scaled = (picture @ homography @ np.linalg.inv(wall)).ravel()
        start = np.concatenate([scaled[:8] / scaled[8], np.zeros(order), angles])
        # Tolerances at the limit of double precision: exact marks must give an exact view.
        fit = least_squares(residuals, start, method="lm", xtol=1e-13, ftol=1e-13, gtol=1e-13)
    except (ValueError, np.linalg.LinAlgError):  # a horizon through the marks, or no homography
        raise PhotographError(
            "no view of a plane wall shows the marks like this; look at their order, and at each "
            "number"
        ) from None
    return FittedView(
        marks, view_of(fit.x), places_of(fit.x), fit.fun.reshape(-1, 2),
        fit.fun.size - fit.x.size,
        lambda points: _derivative(lambda solution: pixels_of(solution, points), fit.x),
    )  # fmt: skip


def _start(marks: Marks) -> tuple[Array, Array]:
    """Return a homography and the angles of tags to begin with; points have no angles."""
    if not marks.are_tags:
        return fit_homography(marks.centers, marks.pixels[:, 0]), np.zeros(0)
    # The largest tag shows the view but for its own turn; the other tags' middles show that.
    points, plane = marks.as_points(), np.array([1, 1j])
    largest = int(np.linalg.norm(marks.pixels[:, 2] - marks.pixels[:, 0], axis=1).argmax())
    seen = np.linalg.inv(fit_homography(marks.arms[largest], marks.pixels[largest]))
    # As complex numbers x + iy: the angle of a sum of products w z* is that of the turn which
    # brings the z nearest to the w, in least squares.
    offsets = project(seen, points.pixels[:, 0]) @ plane
    expected = (marks.centers - marks.centers[largest]) @ plane
    turn = np.angle(np.sum(expected * offsets.conj()))
    on_wall = marks.turned(np.full(len(marks), turn))[largest]
    homography = fit_homography(on_wall, marks.pixels[largest])
    back = project(np.linalg.inv(homography), marks.pixels.reshape(-1, 2)).reshape(-1, 4, 2)
    turned = (back - marks.centers[:, np.newaxis]) @ plane
    return homography, np.angle(np.sum(turned * (marks.arms @ plane).conj(), axis=1))


def _on_a_line(points: Array) -> bool:
    """Return whether (n, 2) points, three or more, lie on a line, within `LINE_WIDTH` of it."""
    length, width = np.linalg.svd(points - points.mean(axis=0), compute_uv=False)
    return bool(width <= LINE_WIDTH * length)


def _derivative(function: Callable[[Array], Array], at: Array) -> Array:
    """Return the derivative of a function's ravelled values, by central differences."""
    # Unknowns are about 1, see `_least_squares`: the step balances curvature and rounding.
    steps = 1e-6 * np.eye(len(at))
    moved = [(function(at + step) - function(at - step)).ravel() / 2e-6 for step in steps]
    return np.stack(moved, axis=1)


def _p_value(simple: FittedView, rich: FittedView) -> float:
    """Return the probability that chance alone reduces the squares as much as the richer fit.

    The simpler fit has more unknowns fixed, or a mark more to explain. The ratio of what is taken
    off to the rest, each per degree of freedom, has the F distribution.
    """
    from scipy.special import fdtrc

    more = simple.freedom - rich.freedom
    gained = max(simple.squares - rich.squares, 0) / more
    return float(fdtrc(more, rich.freedom, gained / (rich.squares / rich.freedom)))


def _coefficients(points: Marks, size: tuple[int, int]) -> int:
    """Return how many coefficients of the lens the points support."""
    order = 0
    # Each point measures a column and a row; a homography has 8 unknowns, the next lens order + 1.
    while order < MOST_COEFFICIENTS and 2 * len(points) - (9 + order) >= FEWEST_FREE:
        simple, rich = (_least_squares(points, size, order + more) for more in (0, 1))
        if _p_value(simple, rich) > SIGNIFICANCE:
            break
        order += 1
    return order


def _check_each(points: Marks, size: tuple[int, int], order: int) -> None:
    """Raise if a point disagrees with the others."""
    count = len(points)
    if 2 * (count - 1) <= 8 + order:  # without one, the others fit exactly and show no error
        return
    whole = _least_squares(points, size, order)
    rest = [_least_squares(points.without(k), size, order) for k in range(count)]
    chances = [_p_value(whole, each) for each in rest]
    worst = int(np.argmin(chances))
    if chances[worst] * count >= SIGNIFICANCE:
        return
    column, row = points.pixels[worst, 0]
    off = rest[worst].view.pixels_of(points.centers[worst : worst + 1])[0] - (column, row)
    raise PhotographError(
        f"{points.names[worst]} at column {column:.1f}, row {row:.1f} lies {np.hypot(*off):.1f} "
        f"pixels from where the other {count - 1} place it (their own error is "
        f"{rest[worst].error:.2f}); measure it again, or leave it out"
    )
