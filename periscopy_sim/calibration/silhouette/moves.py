"""Masks that a search goes on to: random ones, shifted ones, opaque and open ones."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from periscopy_sim.calibration.silhouette.evidence import (
    OUTLINE,
    MaskEvidence,
    MaskFit,
    Stages,
    cost_of_place,
    descend,
    opaque,
    usual_opacity,
)
from periscopy_sim.scenario import Array

SMOOTH, FILLED, STEEPNESS = 1 / 6, (0.3, 0.6), 2.0
"""Of random masks: the deviation of the Gaussian that smooths them, over the cells along a side;
the fraction that is more opaque than open; the steepness of opacities by the smoothed noise."""

ONWARD: Stages = ((0.0, 30),)
LOOK: Stages = ((0.0, 15),)

WALKED, LEAST = 6, 1.0
"""Patches that a mask walks, at most, and what a step must gain: of half the evidence."""

FARTHEST, KEPT = 3, 0.9
"""Steps by which a mask is shifted either way, at most; fraction of it that must stay within its
rectangle."""

THRESHOLDS, ROUNDS = (0.3, 0.4, 0.5, 0.6, 0.7), 12
"""Of opacities, over what is usual of opaque cells; rounds of flips, at most."""


def smooth_mask(cells: tuple[int, int], random: np.random.Generator) -> Array:
    """Return a random mask, (rows, columns), of a few smooth pieces.

    One of small dots, before an image of the mask's shadow, is where rougher starts end.
    """
    from scipy.ndimage import gaussian_filter

    noise = gaussian_filter(random.standard_normal(cells), SMOOTH * np.array(cells), mode="reflect")
    height = noise - np.quantile(noise, 1 - random.uniform(*FILLED))
    return np.asarray(1 / (1 + np.exp(-STEEPNESS * height / max(float(noise.std()), 1e-300))))


def resized(opacities: Array, cells: tuple[int, int]) -> Array:
    """Return opacities on a grid of other cells, (rows, columns): those of the nearest ones."""
    rows, columns = (
        ((np.arange(new) + 0.5) * old / new).astype(int)
        for new, old in zip(cells, opacities.shape, strict=True)
    )
    return np.asarray(opacities[np.ix_(rows, columns)])


def shifted(opacities: Array, steps: Array, farthest: int = FARTHEST) -> list[Array]:
    """Return a mask, (rows, columns), at places to which it can be shifted, its own first.

    They are so many of the `steps`, (2, 2) cells down and across, away at most. Most of each stays
    within the rectangle.
    """
    from scipy.ndimage import shift

    solid = opacities * opaque(opacities)  # what is faint everywhere is no part of the mask
    counts = range(-farthest, farthest + 1)
    others = [np.array([a, b]) @ steps for a in counts for b in counts if (a, b) != (0, 0)]
    return [
        opacities,
        *(
            shift(opacities, by, order=1)
            for by in others
            if shift(solid, by, order=1).sum() >= KEPT * solid.sum()
        ),
    ]


def walk(evidence: MaskEvidence, fit: MaskFit, steps: Array) -> MaskFit:
    """Return where opacities lead from which no step of one patch, either way, gains.

    Shifted against each other by a patch, mask and image explain a photograph nearly as well: a
    descent ends at any of these places, with edges that are frayed at most of them. A short descent
    from each of the eight about one tells which is the best.
    """
    for _ in range(WALKED):
        _, *around = shifted(fit.opacities, steps, farthest=1)
        looks = [descend(evidence, place, LOOK) for place in around]
        best = min([fit, *looks], key=lambda each: each.objective)
        if best is fit:
            return fit
        end = descend(evidence, best.opacities, ONWARD)
        if not end.objective < fit.objective - LEAST:
            return fit
        fit = end
    return fit


def binarized(evidence: MaskEvidence, opacities: Array) -> MaskFit:
    """Return the best mask of opacities, (rows, columns), cut off at some threshold, improved.

    Its objective is no more than that of any of the thresholds'.
    """
    usual = usual_opacity(opacities)
    masks = [(opacities > part * usual).astype(float) for part in THRESHOLDS]
    best = min((evidence.explain(mask) for mask in masks), key=lambda fit: fit.objective)
    most = opacities.size
    for _ in range(ROUNDS):
        order = flips(best)[:most]
        while order:
            mask = best.opacities.copy()
            mask.ravel()[order] = 1 - mask.ravel()[order]
            found = evidence.explain(mask)
            if found.objective < best.objective:
                best, most = found, min(opacities.size, 2 * len(order))
                break
            order = order[: len(order) // 2]
        if not order:
            break
    return best


def flips(fit: MaskFit) -> list[int]:
    """Return cells whose flips lessen the objective, one after the other, as the linear theory has.

    The greatest gain is taken first, each beside those already taken.
    """
    shape = fit.opacities.shape
    slope, H = fit.linearized()
    m = fit.opacities.ravel() > 0.5
    sign = np.where(m, -1.0, 1.0)
    off = cost_of_place(shape).ravel()
    found: list[int] = []
    free = np.ones(len(m), bool)
    while free.any():
        change = sign * slope + np.diag(H) / 2 + OUTLINE * unlike(m.reshape(shape)) + sign * off
        change[~free] = np.inf
        k = int(np.argmin(change))
        if change[k] >= 0:
            break
        found.append(k)
        free[k] = False
        slope = slope + sign[k] * H[:, k]
        m[k] = not m[k]
    return found


def unlike(mask: NDArray[np.bool_]) -> Array:
    """Return by how many sides the outline grows where a cell flips, (rows x columns,)."""
    grown = np.zeros(mask.shape)
    for axis in (0, 1):
        same = np.where(np.diff(mask, axis=axis), -1.0, 1.0)
        for pad in ((1, 0), (0, 1)):
            ends = [(0, 0), (0, 0)]
            ends[axis] = pad
            grown += np.pad(same, ends)
    return grown.ravel()
