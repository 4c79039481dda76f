"""By how much more a place must explain than another for the photograph to tell them apart.

What no scene explains, of paint, light or the occluder's shape, favours one place over another by
chance. By how much tells the test of Vuong [1] for models that are both wrong: of the difference of
two log-likelihoods, a sum over pixels, the variance is that of its parts. Parts are squares of the
photograph, over which such errors are alike.

References
----------
[1] Vuong, "Likelihood ratio tests for model selection and non-nested hypotheses", Econometrica 57,
1989.
"""

from __future__ import annotations

import numpy as np

from periscopy_sim.calibration.explanation.evidence import Explanation
from periscopy_sim.calibration.explanation.resolution_level import ResolutionLevel
from periscopy_sim.calibration.search.image_shift import BETWEEN_PATCHES, NEGLIGIBLE

CERTAIN = 2.0
"""Standard errors of a difference in evidence that tell two places apart."""

SQUARES = 8
"""Along each side of the photograph."""


def worth(level: ResolutionLevel, here: Explanation, there: Explanation) -> float:
    """Return what a place must gain on another, by `between_patches`, to be moved to.

    Both explain the photograph by the level's own filter.
    """
    least = max(NEGLIGIBLE, CERTAIN * standard_error(level, here, there))
    return BETWEEN_PATCHES * least


def standard_error(level: ResolutionLevel, here: Explanation, there: Explanation) -> float:
    """Return the standard error of the difference in evidence between two places."""
    pixels = np.sum((here.residuals / here.deviations) ** 2, axis=1)
    pixels -= np.sum((there.residuals / there.deviations) ** 2, axis=1)
    down, across = (
        place * SQUARES // size
        for place, size in zip(np.nonzero(level.used), level.photograph_shape, strict=True)
    )
    _, square = np.unique(down * SQUARES + across, return_inverse=True)
    parts = np.bincount(square, pixels)
    return float(np.sqrt(len(parts) * np.var(parts, ddof=1))) if len(parts) > 1 else 0.0
