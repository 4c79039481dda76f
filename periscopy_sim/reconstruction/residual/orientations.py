"""Photographs that came mirrored or rotated: which orientation a scene explains best."""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np
from numpy.typing import NDArray
from scipy import ndimage

Array = NDArray[np.float64]

Orientation = tuple[slice, slice]
AS_IT_IS: Orientation = slice(None), slice(None)

FLIPPED: Mapping[str, Orientation] = {
    "mirrored left to right": (slice(None), slice(None, None, -1)),
    "mirrored top to bottom": (slice(None, None, -1), slice(None)),
    "rotated by 180 degrees": (slice(None, None, -1), slice(None, None, -1)),
}
"""Rows and columns of a photograph that is flipped so."""

BETTER = 0.6
"""Part of the unexplained energy below which another orientation is told: of a chair that stands
5 cm off, mirrored, 0.57 stays once flipped. Of photographs that are right, of scenes as far off,
none left less flipped than as it was; of a chair 8 cm off one did. So it is a hint, no more."""

LACKING = 0.05
"""Part of the pixels used, at most, whose mirror images a mask leaves out."""


def better_orientation(as_it_is: float, flipped: Mapping[str, float]) -> str:
    """Return which of `FLIPPED` leave much less energy unexplained; empty where none does.

    Those that can hardly be told from the best are named, too.
    """
    best = min(flipped.values(), default=np.inf)
    if not best < BETTER * as_it_is:
        return ""
    most = min(max(best, 0.0) / BETTER, BETTER * as_it_is)
    return " or ".join(name for name, left in flipped.items() if left <= max(most, best))


def seen_flipped(planes: Array) -> dict[str, Array]:
    """Return (K, rows, columns) light as it would be seen flipped, by name.

    Where pixels are left out there, as NaN, the nearest one that is not stands in; where that would
    be many, nothing is told.
    """
    left_out = np.asarray(np.isnan(planes[0]))
    nearest = ndimage.distance_transform_edt(left_out, return_distances=False, return_indices=True)
    whole = planes[:, *nearest]
    most = LACKING * np.count_nonzero(~left_out)
    return {
        name: whole[:, *flip]
        for name, flip in FLIPPED.items()
        if np.count_nonzero(left_out[flip] & ~left_out) <= most
    }
