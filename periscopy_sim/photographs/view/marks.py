"""Marks on a plane wall and where a photograph shows them: points, or square tags."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from periscopy_sim.photographs.view.homography import Array, fit_homography, project


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
