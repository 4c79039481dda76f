"""Transport matrices of the places that were looked at last: a search comes back to them."""

from __future__ import annotations

from collections.abc import Callable, Hashable

import numpy as np
from numpy.typing import NDArray

Matrix = NDArray[np.float32]

KEPT = 4
"""Matrices, each some 20 MB at most."""


class LastMatrices:
    """What was computed for the last few places, whatever names a place."""

    def __init__(self) -> None:
        self._kept: dict[Hashable, Matrix] = {}

    def at(self, place: Hashable, compute: Callable[[], Matrix]) -> Matrix:
        """Return the matrix at a place, which is not to be written to; computed if it must be."""
        A = self._kept.pop(place) if place in self._kept else compute()
        A.flags.writeable = False
        self._kept[place] = A
        if len(self._kept) > KEPT:
            del self._kept[next(iter(self._kept))]
        return A
