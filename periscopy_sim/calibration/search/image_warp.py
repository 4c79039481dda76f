"""Warps of the hidden image that parameters undo, so that a photograph finds them up to patches.

A photograph does not tell a small occluder that moves from an image that is shifted the other way,
as a pinhole camera does not; nor one that comes nearer, or is larger, from an image that is
stretched. An image on a grid follows by whole patches alone: in between the evidence has a ridge.
So such parameters may be found about a patch of warp off, see `patch_walk`.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray
from scipy.linalg import eigh

from periscopy_sim.calibration.explanation.evidence import Explanation
from periscopy_sim.calibration.search.fisher_information import UNSEEN, Curvature
from periscopy_sim.scenario import Array

LEFT = 0.25
"""Part of what a warp does to the photograph, at most, that parameters leave of it."""

SAME = 0.95
"""Part of a mixture that displacements walked by themselves may have for it to be walked, too."""


def displacements(hidden_shape: tuple[int, int]) -> Array:
    """Return affine displacements of an image's patches, (K, 2, R, C), down and across.

    They are shifts, stretches and shears, each by a patch in the root mean square. A row or a
    column of patches is not displaced out of its line.
    """
    places = np.meshgrid(*(np.linspace(-1, 1, size) for size in hidden_shape), indexing="ij")
    long = np.array(hidden_shape) > 1
    fields = [np.ones(hidden_shape), *(places[axis] for axis in np.flatnonzero(long))]
    found = np.zeros((long.sum(), len(fields), 2, *hidden_shape))
    for k, axis in enumerate(np.flatnonzero(long)):
        found[k, :, axis] = [field / np.sqrt(np.mean(field**2)) for field in fields]
    return found.reshape(-1, 2, *hidden_shape)


def warped(images: Array, displacement: Array) -> Array:
    """Return images, (N, 3), displaced by so many patches, (2, R, C); what enters is black."""
    from scipy.ndimage import map_coordinates

    shape = displacement.shape[1:]
    sources = np.indices(shape) - displacement
    moved = [map_coordinates(f.reshape(shape), sources, order=1).ravel() for f in images.T]
    return np.column_stack(moved)


def undone(
    explanation: Explanation,
    about: Curvature,
    hidden_shape: tuple[int, int],
    free: NDArray[np.bool_],
) -> tuple[Array, Array]:
    """Return how far parameters move to undo warps of the image, and which.

    Parameters
    ----------
    explanation, about
        Of the photograph, where the parameters are now.
    hidden_shape
        (R, C).
    free
        (P,) which parameters may move, as far as the ruler lets them.

    Returns
    -------
    moves, warps
        (P, W) of parameters, and (K, W) how much there is of each of the `displacements`: together
        a patch in the root mean square. Of what the warp does to the photograph at most `LEFT`
        stays. They are those of the `displacements` of which that is so, for an image on a grid
        follows by whole patches along it, and of the easiest mixtures those that are none of these.
    """
    fields = displacements(hidden_shape)
    nothing = np.zeros((len(free), 0)), np.zeros((len(fields), 0))
    if not len(fields) or not free.any():  # of a lone patch there is none
        return nothing
    light = np.array(
        [
            explanation.shown((warped(explanation.images, d) - warped(explanation.images, -d)) / 2)
            for d in fields
        ]
    ).reshape(len(fields), -1)
    if not light.any():
        return nothing
    moved = about.jacobian.moved.mean(axis=0)[free].reshape(free.sum(), -1)
    normal = moved @ moved.T + np.diag(about.prior.precision[free])
    if not normal.any(axis=0).all():
        return nothing
    normal[np.diag_indices_from(normal)] *= 1 + UNSEEN
    undoing = -np.linalg.solve(normal, moved @ light.T)
    whole = light @ light.T
    # A warp that does nothing to the photograph is none that anything undoes.
    ridge = UNSEEN * np.trace(whole) / len(whole) * np.eye(len(whole))
    left = whole + (moved @ light.T).T @ undoing
    left = (left + left.T) / 2 + ridge
    whole += ridge
    parts, mixtures = eigh(left, whole)
    mixtures = (mixtures / np.linalg.norm(mixtures, axis=0))[:, parts < LEFT]
    plain = np.diag(left) < LEFT * np.diag(whole)
    mixed = np.linalg.norm(mixtures[plain], axis=0) < SAME
    warps = np.hstack([np.eye(len(whole))[:, plain], mixtures[:, mixed]])
    moves = np.zeros((len(free), warps.shape[1]))
    moves[free] = undoing @ warps
    return moves, warps
