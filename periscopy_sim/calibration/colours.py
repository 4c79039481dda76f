"""How cameras mix the colours of a monitor: what is known of a colour matrix before a photograph.

Raw converters publish each camera's matrix from XYZ to its channels. That matrix times an sRGB
monitor's from primaries to XYZ is the colour matrix, its rows of sum 1, as exposures are free. The
numbers are of 406 different matrices of 550 cameras in dcraw's table `adobe_coeff` (Coffin, dcraw
9.28, 2018). Half of all photographs may have the monitor's colours already, but for deviations like
cameras'. The normal prior of a row has the mean and the covariance of this mixture.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from periscopy_sim.numerics import Array

CAMERAS = np.array([[0.640, 0.242, 0.118], [0.069, 0.736, 0.195], [0.019, 0.230, 0.751]])
"""(3, 3) mean colour matrix, from red, green and blue to the camera's."""

COVARIANCES = 1e-4 * np.array(
    [
        [[61, -64, 3], [-64, 88, -24], [3, -24, 21]],
        [[34, -26, -8], [-26, 41, -15], [-8, -15, 23]],
        [[24, 7, -31], [7, 27, -34], [-31, -34, 65]],
    ]
)
"""(3, 3, 3) of each of its rows."""


_HALVES = (np.eye(3) - CAMERAS) / 2
MEANS, VARIANCES = CAMERAS + _HALVES, COVARIANCES + np.einsum("ci,cj->cij", _HALVES, _HALVES)
"""(3, 3) and (3, 3, 3) mean and covariance of each row of the prior."""


def row_priors(channels: int, primaries: int) -> Sequence[tuple[Array, Array] | None]:
    """Return mean, (3,), and covariance, (3, 3), of each row of a colour matrix over its sum.

    They are None for other than three channels and primaries, of which no prior is known.
    """
    known = zip(MEANS, VARIANCES, strict=True)
    return list(known) if (channels, primaries) == MEANS.shape else [None] * channels
