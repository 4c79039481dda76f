"""Photographs averaged to as many pixels as calibration needs."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Self

import numpy as np
from numpy.typing import NDArray

from periscopy_sim.photograph import Photograph, blackened
from periscopy_sim.scenario import Array
from periscopy_sim.storage.pictures import area_average

LARGEST = 126
"""Rows and columns to which photographs are averaged, and wall points along them, at least."""

COVERED = 0.5
"""Fraction of an averaged pixel that the mask must leave."""


@dataclass(frozen=True, eq=False)
class Averaged:
    """Pixels used, (rows, columns), and photographs, (rows, columns, ...), averaged to them."""

    used: NDArray[np.bool_]
    light: list[Array]
    monitor_off: list[Array]

    @classmethod
    def of(cls, photographs: Sequence[Photograph], longest: int = LARGEST) -> Self:
        """Average photographs of one size and mask to at most so many pixels along a side."""
        one = photographs[0]
        shape = fitted(one.shape, longest)
        mask = np.ones(one.shape, bool) if one.mask is None else one.mask
        covered = area_average(mask[..., None], shape)
        used = covered[..., 0] > COVERED + 1e-6  # ties are decided alike in mirror images

        def averaged(values: Array) -> Array:
            return area_average(blackened(values, mask), shape) / np.maximum(covered, COVERED)

        light = [averaged(each.values) for each in photographs]
        return cls(used, light, [averaged(each) for each in one.monitor_off.values()])


def fitted(size: tuple[int, int], longest: int) -> tuple[int, int]:
    """Return (rows, columns) shrunk in proportion, the longer to at most `longest`."""
    factor = min(1.0, longest / max(size))
    rows, columns = (max(1, round(factor * n)) for n in size)
    return rows, columns
