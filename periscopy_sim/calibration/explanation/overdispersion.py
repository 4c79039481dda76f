"""How much less an explanation's residual tells than white noise would."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from periscopy_sim.calibration.explanation.evidence import Explanation
from periscopy_sim.model.overdispersion import overdispersion_of


def overdispersion(explanation: Explanation, used: NDArray[np.bool_], seed: int) -> float:
    """Return κ of what an explanation leaves of the pixels used; see `overdispersion_of`."""
    noise = np.where(explanation.noise > 0, explanation.noise, np.inf)
    return overdispersion_of(explanation.residuals / noise, explanation.left_of, used, seed)
