"""The silhouette of an occluder nobody measured, and how far it is to be believed."""

from __future__ import annotations

from dataclasses import dataclass, field

import numpy as np

from periscopy_sim.calibration.silhouette.plane import Cells, MaskPlane
from periscopy_sim.calibration.whitening import STRUCTURED
from periscopy_sim.scenario import Array

FARTHEST = 4
"""Cells by which two masks are shifted against each other, at most, to be compared."""


BETWEEN = 4.0
"""See `Silhouette.between`; from here on cells do not have the mask's outline."""

TWICE = 2
"""Starts that must end at a mask: one may be luck."""


@dataclass(frozen=True, eq=False)
class Silhouette:
    """A flat mask that explains a photograph, found with the hidden image.

    Where the mask moves a little and the image against it, the photograph hardly changes: both may
    be shifted. `others` are answers that explain the photograph alike.

    Attributes
    ----------
    name
        Of the shape that it takes the place of.
    plane
        The rectangle of its cells.
    opaque
        (rows, columns) of cells, top left first as one sees it who faces the wall.
    seen
        (rows, columns) whether the photograph shows the cell's shadow; else its neighbours' word.
    told
        How many numbers of the mask the photograph tells: at most as many as cells are seen.
    image
        (R, C, 3) the hidden image that was found with it, linear, R x C as far as it was looked at.
    unexplained
        What mask and image leave of the photograph, over its root mean square.
    unexplained_open
        The same without a mask: how much its shadow tells.
    unexplained_partly
        The same with the best mask whose cells may be partly open.
    between
        How much better that explains the photograph, in twice the logarithm of the likelihood, for
        each number that is told: 1 of a mask whose outline is that of cells.
    residual
        (rows, columns, 3) what is left, over the photograph's root mean square.
    overdispersion
        How many times stronger that is than white noise, see `overdispersion`.
    evidence
        Twice the negative logarithm of the photograph's likelihood: less is better.
    others
        Answers that explain the photograph alike.
    agreeing, starts
        How many of the search's starts ended at this mask, roughly; of how many.
    """

    name: str
    plane: MaskPlane
    opaque: Cells
    seen: Cells
    told: float
    image: Array = field(repr=False)
    unexplained: float
    unexplained_open: float
    unexplained_partly: float
    between: float
    residual: Array = field(repr=False)
    overdispersion: float
    evidence: float
    others: tuple[Silhouette, ...] = ()
    agreeing: int = 0
    starts: int = 0

    @property
    def doubts(self) -> tuple[str, ...]:
        """Why it is not to be believed; empty if nothing speaks against it."""
        doubts = []
        if self.overdispersion > STRUCTURED:
            doubts.append(
                f"what the mask leaves unexplained is {self.overdispersion:.0f} times stronger "
                "than noise at some scale: the occluder is not flat, or finer than the cells, or "
                "the patches are larger than the image's details, or the scene is wrong elsewhere"
            )
        elif self.between > BETWEEN:
            less = 100 * (1 - self.unexplained_partly / self.unexplained)
            doubts.append(
                f"cells that are partly open leave {less:.0f} % less unexplained: some are wrong, "
                "or the occluder's outline lies between them"
            )
        if self.agreeing < TWICE:
            doubts.append(
                f"{self.agreeing} of the search's {self.starts} starts ended near it: there may be "
                "a better one"
            )
        if self.others:
            doubts.append("another silhouette explains the photograph as well")
        return tuple(doubts)


def overlap(one: Cells, other: Cells, farthest: int = FARTHEST) -> float:
    """Return the area that two masks share over that of both, shifted to where that is largest.

    By whole cells, at most `farthest` along either axis; what a shift brings in is open.
    """
    wide = np.pad(other, farthest)
    rows, columns = one.shape
    best = 0.0
    for down in range(2 * farthest + 1):
        for right in range(2 * farthest + 1):
            moved = wide[down : down + rows, right : right + columns]
            either = np.count_nonzero(one | moved)
            best = max(best, np.count_nonzero(one & moved) / either if either else 0.0)
    return best
