"""Masks that explain a photograph nearly as another does: shifted, or with the image's place."""

from __future__ import annotations

import numpy as np

from periscopy_sim.calibration.silhouette.cells.mask_plane import MaskPlane
from periscopy_sim.calibration.silhouette.search.mask_level import (
    NOTHING,
    MaskFit,
    MaskLevel,
    opaque,
)
from periscopy_sim.scenario import Array, Scenario

FARTHEST = 3
"""Steps by which a mask is shifted either way, at most."""

KEPT = 0.9
"""Part of a mask that must stay within its rectangle where it is shifted."""


def swapped(level: MaskLevel, plane: MaskPlane, fit: MaskFit) -> Array:
    """Return the mask that is the image of a fit, turned by half a circle, (rows, columns).

    From x, mask m and image f are seen as ∫ m(x + t (q − x)) f(q) dq, t the part of the way at
    which the mask stands. f(−p/t) in the place of the mask, m(−t q) in that of the image give the
    same for all x but for a shift.
    """
    from scipy.spatial import KDTree

    scenario = level.level.scenario(NOTHING)
    rows, columns = level.cells
    down, across = np.indices(level.cells) + 0.5
    cells = plane.at(np.stack([across / columns, down / rows], axis=-1)).reshape(-1, 3)
    monitor = scenario.patch_centers.mean(axis=0)
    middle = plane.at(np.array([0.5, 0.5]))
    places = monitor - (cells - middle) / plane.part(scenario)
    distance, nearest = KDTree(scenario.patch_centers).query(places)
    size = np.sqrt(scenario.patch_areas.max())
    grey = np.where(distance < size, fit.explanation.images.mean(axis=1)[nearest], 0.0)
    return np.asarray(grey / max(grey.max(), 1e-300)).reshape(level.cells)


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


def patch_steps(plane: MaskPlane, scenario: Scenario, cells: tuple[int, int]) -> Array:
    """Return how far a mask moves, (2, 2) in cells down and across, as the image does by a patch.

    The first is that of a patch up, the second that of one across. By so much a mask and its image
    may be shifted against each other, and the photograph changes least: in between, an image on a
    grid cannot follow.
    """
    part = plane.part(scenario)
    edges = np.stack([scenario.patch_up.mean(axis=0), scenario.patch_across.mean(axis=0)])
    rows, _ = plane.rows_of_projection()
    return np.asarray(part * edges @ rows[[1, 0]].T * np.array(cells))
