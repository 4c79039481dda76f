"""By how much more a place must explain than another for the photograph to tell them apart.

What no scene explains, of paint, light or the occluder's shape, favours one place over another by
chance. By how much tells the test of Vuong [1] for models that are both wrong: the variance of a
difference of two log-likelihoods, a sum over pixels, is found from its parts. Here it is that of
their misfits (what else the evidence holds does not change with errors), and the parts are blocks
of the photograph, between which such errors are independent.

References
----------
[1] Vuong, "Likelihood ratio tests for model selection and non-nested hypotheses", Econometrica 57,
1989.
"""

from __future__ import annotations

import numpy as np

from periscopy_sim.calibration.explanation.evidence import Explanation
from periscopy_sim.calibration.explanation.resolution_level import ResolutionLevel
from periscopy_sim.calibration.search.fisher_information import blocks
from periscopy_sim.calibration.search.image_shift import BETWEEN_PATCHES, NEGLIGIBLE

CERTAIN = 2.0
"""Standard errors of a difference in evidence that tell two places apart."""


def worth(level: ResolutionLevel, here: Explanation, there: Explanation) -> float:
    """Return what a place must gain on another, by `between_patches`, to be moved to.

    That counts a part of the evidence, and so the same part of its standard error. Both explain the
    photograph by the level's own filter.
    """
    least = max(NEGLIGIBLE, CERTAIN * standard_error(level, here, there))
    return BETWEEN_PATCHES * least


def standard_error(level: ResolutionLevel, here: Explanation, there: Explanation) -> float:
    """Return the standard error of the difference in evidence between two places."""
    pixels = np.sum((here.residuals / here.deviations) ** 2, axis=1)
    pixels -= np.sum((there.residuals / there.deviations) ** 2, axis=1)
    _, block = np.unique(blocks(level), return_inverse=True)
    parts = np.bincount(block, pixels)
    return float(np.sqrt(len(parts) * np.var(parts, ddof=1))) if len(parts) > 1 else 0.0
