"""Marks on a plane wall: points that were clicked, and square tags that hang in any way."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from periscopy_sim.errors import PhotographError
from periscopy_sim.photographs.wall_view import fit_homography, project
from periscopy_sim.scenario import Array


@dataclass(frozen=True, eq=False)
class WallPoints:
    """Points of the wall, and where they were clicked in a photograph.

    Attributes
    ----------
    pixels
        (n, 2) column and row; the first pixel's centre is at (0.5, 0.5). For a camera's raw file
        they are the sensor's, as viewers show them.
    positions
        (n, 3) in metres, in the scene's coordinates.
    names
        Names of the points in messages; empty for numbers.
    source
        Name of the list in messages.
    """

    pixels: Array
    positions: Array
    names: Sequence[str] = ()
    source: str = "points"


@dataclass(frozen=True, eq=False)
class WallTags:
    """Tags on the wall, turned in any way.

    Attributes
    ----------
    ids
        (n,) their numbers, each once.
    centers
        (n, 3) in metres, in the scene's coordinates.
    sizes
        (n,) sides of their black squares, in metres.
    source
        Name of the list in messages.
    """

    ids: NDArray[np.int64]
    centers: Array
    sizes: Array
    source: str = "tags"

    def __post_init__(self) -> None:
        """Reject a number that is listed twice, and sizes that are not positive."""
        if len(np.unique(self.ids)) < len(self.ids) or not (self.sizes > 0).all():
            raise PhotographError(
                f"{self.source}: list each tag once, with the positive size of its side in metres"
            )


@dataclass(frozen=True, eq=False)
class Marks:
    """Marks in the wall's plane, and where a photograph shows them.

    A point has one place, p = 1; a square tag has four, its corners, turned by an unknown angle.
    Its arms reach from its centre to each corner before the turn; those of a point are 0.
    """

    pixels: Array  # (n, p, 2) column and row
    centers: Array  # (n, 2) metres across and up
    arms: Array  # (n, p, 2) metres
    names: Sequence[str]  # in messages

    @classmethod
    def of_points(cls, pixels: Array, points: Array, names: Sequence[str]) -> Marks:
        """Return (n, 2) pixels and their (n, 2) points of the wall, in metres, as marks."""
        return cls(pixels[:, np.newaxis], points, np.zeros((len(points), 1, 2)), names)

    @classmethod
    def of_tags(cls, corners: Array, centers: Array, sizes: Array, names: Sequence[str]) -> Marks:
        """Return square tags as marks: (n, 4, 2) corners clockwise, (n, 2) centres, (n,) sides."""
        unit = np.array([[-0.5, 0.5], [0.5, 0.5], [0.5, -0.5], [-0.5, -0.5]])
        return cls(corners, centers, sizes[:, np.newaxis, np.newaxis] * unit, names)

    def __len__(self) -> int:
        """Return the number of marks."""
        return len(self.names)

    @property
    def are_tags(self) -> bool:
        """Whether the marks are tags."""
        return len(self.pixels[0]) > 1

    def turned(self, angles: Array) -> Array:
        """Return (n, p, 2) places on the wall of marks turned by (n,) angles in radians."""
        cos, sin = np.cos(angles)[:, np.newaxis], np.sin(angles)[:, np.newaxis]
        x, y = np.moveaxis(self.arms, -1, 0)
        turned = np.stack([cos * x - sin * y, sin * x + cos * y], axis=-1)
        return np.asarray(self.centers[:, np.newaxis] + turned)

    def without(self, mark: int) -> Marks:
        """Return all marks but one."""
        pixels, centers, arms = (
            np.delete(each, mark, axis=0) for each in (self.pixels, self.centers, self.arms)
        )
        return Marks(pixels, centers, arms, [n for k, n in enumerate(self.names) if k != mark])

    def as_points(self) -> Marks:
        """Return the marks as points: the middle of each tag, where its diagonals meet."""
        if not self.are_tags:
            return self
        middles = [
            project(fit_homography(arms, pixels), np.zeros((1, 2)))[0]
            for arms, pixels in zip(self.arms, self.pixels, strict=True)
        ]
        return Marks.of_points(np.array(middles), self.centers, self.names)
