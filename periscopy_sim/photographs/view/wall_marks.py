"""Marks on the wall as a person measures them: points, and square tags."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from periscopy_sim.errors import PhotographError

Array = NDArray[np.float64]


@dataclass(frozen=True, eq=False)
class WallPoints:
    """Points of the wall, and where they were clicked in a photograph.

    Attributes
    ----------
    pixels
        (n, 2) column and row; the first pixel's centre is at (0.5, 0.5). Of a camera's raw file
        they are the sensor's, as viewers show them, not the half as many that are made of them.
    positions
        (n, 3) in metres, in the scene's coordinates.
    names
        What messages call each.
    source
        What messages call the list.
    """

    pixels: Array
    positions: Array
    names: Sequence[str] = ()
    source: str = "points"


@dataclass(frozen=True, eq=False)
class WallTags:
    """Tags as they hang on the wall, turned in any way.

    Attributes
    ----------
    ids
        (n,) their numbers, each once.
    centers
        (n, 3) in metres.
    sizes
        (n,) sides of their black squares, in metres.
    source
        What messages call the list.
    """

    ids: NDArray[np.int64]
    centers: Array
    sizes: Array
    source: str = "tags"

    def __post_init__(self) -> None:
        """Refuse a number that is there twice, and sizes that are not positive."""
        numbers, counts = np.unique(self.ids, return_counts=True)
        if (counts > 1).any():
            raise PhotographError(
                f"{self.source}: tag {numbers[counts > 1][0]} is listed twice; list each once"
            )
        if not (self.sizes > 0).all():
            raise PhotographError(
                f"{self.source}: a tag's size is not positive; give its side in metres"
            )
