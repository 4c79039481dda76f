"""Opaque or open: the mask of cells that explains a photograph best, found by flips."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from periscopy_sim.calibration.silhouette.search.mask_level import MaskFit, MaskLevel, usual_opacity
from periscopy_sim.calibration.silhouette.search.mask_prior import OUTLINE, cost_of_place
from periscopy_sim.scenario import Array

THRESHOLDS = (0.3, 0.4, 0.5, 0.6, 0.7)
"""Of opacities, over what is usual of opaque cells, that are tried."""

ROUNDS = 12
"""Of flips, each after what the one before found, at most."""


def binarized(level: MaskLevel, opacities: Array) -> MaskFit:
    """Return the best mask of opacities, (rows, columns), cut off at some threshold, improved.

    Its objective is no more than that of any of the thresholds'.
    """
    usual = usual_opacity(opacities)
    masks = [(opacities > part * usual).astype(float) for part in THRESHOLDS]
    best = min((level.explain(mask) for mask in masks), key=lambda fit: fit.objective)
    most = opacities.size
    for _ in range(ROUNDS):
        flips = _flips(level, best)
        gain = 0.0
        while flips and gain <= 0:
            flips = flips[:most]
            mask = best.opacities.copy()
            mask.ravel()[flips] = 1 - mask.ravel()[flips]
            found = level.explain(mask)
            gain = best.objective - found.objective
            if gain <= 0:
                most = len(flips) // 2
                flips = flips[:most]
        if gain <= 0:
            break
        best = found
        most = min(opacities.size, 2 * max(most, 1))
    return best


def _flips(level: MaskLevel, here: MaskFit) -> list[int]:
    """Return cells whose flips lessen the objective, one after the other, as the linear theory has.

    The greatest gain is taken first, each beside those already taken.
    """
    shape = here.opacities.shape
    g, H = level.linearized(here)
    m = here.opacities.ravel() > 0.5
    sign = np.where(m, -1.0, 1.0)
    slope, off = g.copy(), cost_of_place(shape).ravel()
    found: list[int] = []
    free = np.ones(len(m), bool)
    while free.any():
        change = sign * slope + np.diag(H) / 2 + OUTLINE * _unlike(m.reshape(shape)) + sign * off
        change[~free] = np.inf
        k = int(np.argmin(change))
        if change[k] >= 0:
            break
        found.append(k)
        free[k] = False
        slope = slope + sign[k] * H[:, k]
        m[k] = not m[k]
    return found


def _unlike(mask: NDArray[np.bool_]) -> Array:
    """Return by how many sides the outline grows where a cell flips, (rows x columns,)."""
    grown = np.zeros(mask.shape)
    for axis in (0, 1):
        same = np.where(np.diff(mask, axis=axis), -1.0, 1.0)
        pads = (
            [((1, 0), (0, 0)), ((0, 1), (0, 0))]
            if axis == 0
            else [((0, 0), (1, 0)), ((0, 0), (0, 1))]
        )
        grown += sum(np.pad(same, pad) for pad in pads)
    return grown.ravel()
