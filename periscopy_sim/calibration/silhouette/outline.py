"""How improbable a mask is before any photograph: by the length of its outline."""

from __future__ import annotations

import numpy as np

from periscopy_sim.scenario import Array

OUTLINE = 1.0
"""Of half the evidence, a side of a cell: at Ising's critical 0.88 islands of any size are as
likely."""

ROUNDED = 0.05
"""Differences of opacities below which their penalty is quadratic."""


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
