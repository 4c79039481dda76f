"""By how much more a place must explain than another for the photograph to tell them apart.

What no scene explains, of paint, light or the occluder's shape, favours one place over another by
chance. By how much tells the test of Vuong [1] for models that are both wrong: the variance of a
difference of two log-likelihoods, a sum over pixels, is found from its parts. Here these are blocks
of the photograph, between which such errors are taken as independent. Each adds to the misfit (what
else the evidence holds does not change with errors), and to the ruler's penalty by how far the
values follow it: they are where evidence and penalty are least, each counted in full, and not where
that is least by which places are compared.

References
----------
[1] Vuong, "Likelihood ratio tests for model selection and non-nested hypotheses", Econometrica 57,
1989.
"""

from __future__ import annotations

import numpy as np

from periscopy_sim.calibration.explanation.evidence import Explanation
from periscopy_sim.calibration.explanation.resolution_level import ResolutionLevel, Values
from periscopy_sim.calibration.search.fisher_information import Curvature, block_scores, blocks
from periscopy_sim.calibration.search.image_shift import BETWEEN_PATCHES, NEGLIGIBLE
from periscopy_sim.scenario import Array

CERTAIN = 2.0
"""Standard errors of a difference that tell two places apart."""

Place = tuple[Values, Explanation]
"""Values, (P,), and what is seen there by a level's own filter."""


def least_gain(level: ResolutionLevel, about: Curvature, here: Place, there: Place) -> float:
    """Return the least gain of a place on another, by `between_patches`, to move there.

    The curvature is that about either: of one patch and the next it is much the same.
    """
    certain = CERTAIN * standard_error(level, about, here, there)
    return max(BETWEEN_PATCHES * NEGLIGIBLE, certain)


def standard_error(level: ResolutionLevel, about: Curvature, here: Place, there: Place) -> float:
    """Return the standard error of the difference by `between_patches` of two places."""
    parts = _parts(level, about, *here) - _parts(level, about, *there)
    return float(np.sqrt(len(parts) * np.var(parts, ddof=1))) if len(parts) > 1 else np.inf


def _parts(level: ResolutionLevel, about: Curvature, values: Values, seen: Explanation) -> Array:
    """Return what each block of pixels adds to what a place is compared by, (blocks,)."""
    _, block = np.unique(blocks(level), return_inverse=True)
    misfit = np.bincount(block, np.sum((seen.residuals / seen.deviations) ** 2, axis=1))
    scores = block_scores(level, seen, about.jacobian)[0]
    followed = np.linalg.solve(about.invertible(), scores.T)  # how far the values go with a block
    penalty = 2 * level.prior.slope(values) @ followed
    return np.asarray(BETWEEN_PATCHES * misfit + (1 - BETWEEN_PATCHES) * penalty)
