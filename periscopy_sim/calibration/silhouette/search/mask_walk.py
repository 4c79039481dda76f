"""Walks of a mask and its image, against each other, from one patch of the image to the next.

Shifted against each other by a patch, mask and image explain a photograph nearly as well: a little
worse where the mask's edges then lie within cells. A descent ends at any of these places, with
edges that are frayed at most of them, and from there leads to none of the others.
"""

from __future__ import annotations

from collections.abc import Callable

from periscopy_sim.calibration.silhouette.search.mask_evidence import MaskEvidence
from periscopy_sim.calibration.silhouette.search.mask_moves import shifted
from periscopy_sim.calibration.silhouette.search.opacity_descent import (
    ONWARD,
    Descended,
    Stages,
    descend,
)
from periscopy_sim.scenario import Array

LOOK: Stages = ((0.0, 15),)
"""Of a descent that tells what a place is worth."""

WALKED = 6
"""Patches, at most; so far a mask hardly goes without leaving its rectangle."""

LEAST = 1.0
"""What a step must gain: of half the evidence."""


def walk(
    evidence: MaskEvidence,
    found: Descended,
    steps: Array,
    looked: Callable[[], None] = lambda: None,
) -> Descended:
    """Return where opacities lead from which no step of one patch, either way, gains.

    The steps are those of `patch_steps`. Of the eight places about one, a short descent from each
    tells which is the best; `looked` is called after each.
    """
    for _ in range(WALKED):
        _, *places = shifted(found.opacities, steps, farthest=1)
        best = found
        for place in places:
            look = descend(evidence, place, LOOK)
            looked()
            if look.objective < best.objective:  # which no NaN is
                best = look
        end = best if best is found else descend(evidence, best.opacities, ONWARD)
        if not end.objective < found.objective - LEAST:
            return found
        found = end
    return found
