"""Stripes along a photograph's border, as resampling and demosaicking leave them."""

from __future__ import annotations

from dataclasses import astuple, dataclass

import numpy as np
from numpy.typing import ArrayLike, NDArray

PARTS = 8  # of a side, each of which must show the stripe
DEEPEST = 0.03  # depth of a stripe at most, as a fraction of the photograph's rows or columns

GROSS = 0.1
"""Least step of a stripe, as a fraction of a channel's mean light. The borders of three real
photographs have steps up to 0.047; masking a step of 0.026 loses 0.8 dB."""

STEEPER = 3.0
"""Least step of a stripe over the steepest inside. At 2, two of 1,920 closed-form photographs of
displaced scenes have a stripe, the edge of a board along a whole side."""

SMALLEST = 32  # rows and columns of a photograph that is searched


@dataclass(frozen=True)
class BadBorder:
    """Numbers of rows and columns that stand out at each side of a photograph."""

    top: int = 0
    bottom: int = 0
    left: int = 0
    right: int = 0

    def __bool__(self) -> bool:
        """Return whether any row or column stands out."""
        return any(astuple(self))

    def __str__(self) -> str:
        """Return the numbers of lines and the sides."""
        sides = zip(astuple(self), ("top", "bottom", "left", "right"), strict=True)
        return ", ".join(f"{count} at the {side}" for count, side in sides if count)

    def inside(self, shape: tuple[int, int]) -> NDArray[np.bool_]:
        """Return a mask of a photograph's (rows, columns), False in the border."""
        rows, columns = shape
        mask = np.zeros(shape, bool)
        mask[self.top : rows - self.bottom, self.left : columns - self.right] = True
        return mask


def bad_border(photograph: ArrayLike) -> BadBorder:
    """Return the border rows and columns that are outliers beyond doubt.

    Light changes smoothly from row to row. A stripe ends in a step: its last row differs from the
    straight line through the next two rows by `GROSS` of the mean light or more, with one sign in
    all `PARTS` parts of the side, and by `STEEPER` times the steepest such step inside.

    Parameters
    ----------
    photograph
        (rows, columns, channels) in any linear unit, finite.

    Returns
    -------
    BadBorder
        Empty for a photograph with fewer than `SMALLEST` rows or columns.
    """
    values = np.asarray(photograph, np.float64)
    if min(values.shape[:2]) < SMALLEST:
        return BadBorder()
    columns = values.swapaxes(0, 1)
    return BadBorder(*map(_depth, (values, values[::-1], columns, columns[::-1])))


def _depth(lines: NDArray[np.float64]) -> int:
    """Return how many of the first (n, m, channels) lines a stripe has."""
    light = np.abs(lines.mean(axis=(0, 1)))
    parts = np.stack([each.mean(axis=1) for each in np.array_split(lines, PARTS, axis=1)])
    steps = parts[:, :-2] - 2 * parts[:, 1:-1] + parts[:, 2:]
    shared = np.where(np.abs(np.sign(steps).sum(axis=0)) == PARTS, np.abs(steps).min(axis=0), 0)
    deepest = max(1, round(DEEPEST * len(lines)))
    least = np.maximum(GROSS * light, STEEPER * shared[deepest : -deepest - 1].max(axis=0))
    stripes = (shared[:deepest] >= least).any(axis=1) & (light > 0).any()
    return int(np.flatnonzero(stripes).max(initial=-1)) + 1
