"""Walks of a mask and its image, against each other, from one patch of the image to the next.

Shifted against each other by a patch, mask and image explain a photograph nearly as well: a little
worse where the mask's edges then lie within cells. A descent ends at any of these places, with
edges that are frayed at most of them, and from there leads to none of the others.
"""

from __future__ import annotations

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


def walk(evidence: MaskEvidence, found: Descended, steps: Array) -> Descended:
    """Return where opacities lead from which no step of one patch, either way, gains.

    The steps are those of `patch_steps`. Of the eight places about one, a short descent from each
    tells which is the best.
    """
    for _ in range(WALKED):
        _, *places = shifted(found.opacities, steps, farthest=1)
        looks = [descend(evidence, place, LOOK) for place in places]
        best = min(looks, key=lambda look: look.objective, default=found)
        if best.objective >= found.objective:
            return found
        found = descend(evidence, best.opacities, ONWARD)
    return found
