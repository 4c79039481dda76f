"""The view of a wall found from marks on it: points, or square tags of unknown turn.

Least squares over what was clicked or detected in the photograph. How many coefficients of the
lens are found, and whether a mark is wrong, is decided by F tests of nested models: what a further
coefficient, or leaving a mark out, takes off the sum of squares is compared with what is left.
"""

from __future__ import annotations

from dataclasses import dataclass, field

import numpy as np

from periscopy_sim.errors import PhotographError
from periscopy_sim.photographs.view.homography import Array, are_on_a_line
from periscopy_sim.photographs.view.least_squares import LINE, ViewFit, least_squares_view
from periscopy_sim.photographs.view.marks import Marks
from periscopy_sim.photographs.view.wall_view import WallView

SIGNIFICANCE = 0.01
"""Rate at which a lens without distortion is given a coefficient, and right marks a bad one."""

MOST_COEFFICIENTS = 2
FEWEST_FREE = 4
"""Measurements beyond the unknowns, that a fit with distortion must leave."""

ASSUMED = 0.5
"""Pixels that a mark's coordinate is taken to be off, where nothing is left to tell it."""


RULER = 1e-3
"""Metres that a mark's coordinate on the wall may be off by an honest ruler."""


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
    expected
        Root mean square that the residuals would have, in pixels, if marks were off by `ASSUMED`
        pixels in the photograph and by `RULER` on the wall.
    corners
        (k, 2) corners of tags in metres across and up, as they were found to be turned; else empty.
    """

    view: WallView
    marks: Marks = field(repr=False)
    residuals: Array = field(repr=False)
    residuals_on_wall: Array = field(repr=False)
    freedom: int
    error: float
    expected: float
    corners: Array = field(repr=False)
    _fit: ViewFit = field(repr=False)

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
    fit = least_squares_view(marks, size, order)
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
    # What is left of independent errors, of which the view takes its part.
    variance = 2 * ASSUMED**2 + RULER**2 * np.mean(np.sum(slopes**2, axis=(1, 2)))
    expected = float(np.sqrt(variance * fit.freedom / fit.residuals.size))
    turned = fit.placed[marks.arms.any(axis=1)]
    return FittedView(
        fit.view, marks, residuals, on_wall, fit.freedom, float(error), expected, turned, fit
    )


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


# -- tests ---------------------------------------------------------------------------------------


def _p_value(simple: ViewFit, rich: ViewFit) -> float:
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
        if (
            _p_value(
                least_squares_view(points, size, order), least_squares_view(points, size, order + 1)
            )
            > SIGNIFICANCE
        ):
            break
        order += 1
    return order


def _check_each(points: Marks, size: tuple[int, int], order: int) -> None:
    """Refuse a point that does not agree with the others."""
    count = len(points)
    if 2 * (count - 1) <= 8 + order:
        return
    whole = least_squares_view(points, size, order)
    rest = [least_squares_view(points.without(k), size, order) for k in range(count)]
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
