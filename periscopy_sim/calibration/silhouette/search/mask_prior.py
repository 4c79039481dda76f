"""How probable a mask of cells is before any photograph: the shorter its outline, the more.

Of two masks that explain a photograph alike, the one with the shorter outline is the likelier
(Ising's model, with opacities between 0 and 1 on the way), and the one in the middle of its
rectangle.
"""

from __future__ import annotations

import numpy as np

from periscopy_sim.scenario import Array

OUTLINE = 1.0
"""Of half the evidence, a side of a cell: at Ising's critical 0.88 islands of any size are as
likely."""

CENTERED = 1.0
"""Of half the evidence."""

ROUNDED = 0.05
"""Differences of opacities below which their penalty is quadratic."""


def improbability(opacities: Array) -> tuple[float, Array]:
    """Return how improbable a mask, (rows, columns), is before the photograph, and the gradient."""
    length, gradient = _outline(opacities)
    total = OUTLINE * length
    gradient = OUTLINE * gradient
    off = cost_of_place(opacities.shape)
    total += float(np.sum(off * opacities))
    gradient += off
    S1, S2 = float(opacities.sum()), float(np.sum(opacities**2)) + 1e-9
    ratio = S1 / S2
    return total * ratio, gradient * ratio + total * (1 / S2 - 2 * opacities * S1 / S2**2)


def cost_of_place(shape: tuple[int, ...]) -> Array:
    """Return what an opaque cell costs where it is, (rows, columns): most at the border."""
    y, x = (np.abs((np.arange(n) + 0.5) / n * 2 - 1) for n in shape)
    return np.asarray(CENTERED * np.maximum(y[:, None], x) ** 2)


def _outline(opacities: Array) -> tuple[float, Array]:
    """Return the sum of what neighbours differ by, (rows, columns), rounded, and its gradient."""
    total, gradient = 0.0, np.zeros_like(opacities)
    for axis in (0, 1):
        step = np.diff(opacities, axis=axis)
        size = np.sqrt(step**2 + ROUNDED**2)
        total += float((size - ROUNDED).sum())
        slope = step / size
        after = [(1, 0), (0, 0)] if axis == 0 else [(0, 0), (1, 0)]
        before = [(0, 1), (0, 0)] if axis == 0 else [(0, 0), (0, 1)]
        gradient += np.pad(slope, after) - np.pad(slope, before)
    return total, gradient
