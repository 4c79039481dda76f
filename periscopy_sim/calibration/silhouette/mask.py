"""Masks of cells between open, 0, and opaque, 1: what they explain, and which are alike."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from periscopy_sim.scenario import Array

OUTLINE = 1.0
"""Of half the evidence, a side of a cell: at Ising's critical 0.88 islands of any size are as
likely."""

ROUNDED = 0.05
"""Differences of opacities below which their penalty is quadratic."""

FARTHEST = 4
"""Cells by which two masks are shifted against each other, at most, to be compared."""


@dataclass(frozen=True, eq=False)
class MaskFit:
    """Opacities of a mask's cells, (rows, columns), and what they explain of P photographs.

    `evidence` is twice the negative logarithm of the likelihood, `objective` half of it and the
    prior, with its gradient, (K,). The image of the first photograph is (N, 3), residuals are
    (P, M, 3).
    """

    opacities: Array
    evidence: float
    objective: float
    gradient: Array
    image: Array
    residual: Array


def outline(opacities: Array) -> tuple[float, Array]:
    """Return the outline's penalty for opacities, (rows, columns), and its gradient.

    Of two masks that explain a photograph alike, the one with the shorter outline is the likelier
    (Ising's model, with opacities between 0 and 1).
    """
    total, gradient = 0.0, np.zeros_like(opacities)
    for axis in (0, 1):
        step = np.diff(opacities, axis=axis)
        size = np.sqrt(step**2 + ROUNDED**2)
        total += OUTLINE * float((size - ROUNDED).sum())
        slope = OUTLINE * step / size
        ends = [(0, 0), (0, 0)]
        for sign, pad in ((1, (1, 0)), (-1, (0, 1))):
            ends[axis] = pad
            gradient += sign * np.pad(slope, ends)
    return total, gradient


def opaque(opacities: Array) -> NDArray[np.bool_]:
    """Return whether cells, (rows, columns), are opaque rather than not.

    The threshold is half of what is usual among opaque ones: a fainter mask before a brighter image
    makes nearly the same photograph.
    """
    return np.asarray(opacities > usual_opacity(opacities) / 2)


def usual_opacity(opacities: Array) -> float:
    """Return the mean opacity of cells, (rows, columns), each as often as it is opaque."""
    return float(np.sum(opacities**2) / max(float(opacities.sum()), 1e-300))


def overlap(one: NDArray[np.bool_], other: NDArray[np.bool_], farthest: int = FARTHEST) -> float:
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
