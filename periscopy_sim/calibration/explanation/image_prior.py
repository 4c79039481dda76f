"""What is said of hidden images beforehand: f_c ~ N(0, σ_c²/α_c K⁻¹), smooth rather than not.

    fᵀ K f = Σ (difference of neighbours)² + ε ‖f‖²

Beyond the monitor nothing shines: what is bright at the image's border has an edge there, too. Were
there none, an image that is moved until it touches the border, and with it the occluder, would be
smoother than one that does not, and the evidence favour a place whole patches from the right one
(by 200, of a photograph without any error but noise).
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]

BRIGHTNESS = 0.01
"""ε: all that is said of how bright an image is, beside how rough."""


def image_precision(shape: tuple[int, int]) -> Array:
    """Return K for images of (R, C) patches, (R C, R C), the first row of patches first."""
    down, across = (_differences(size) for size in shape)
    K: Array = np.kron(down, np.eye(shape[1])) + np.kron(np.eye(shape[0]), across)
    K[np.diag_indices_from(K)] += BRIGHTNESS
    return K


def _differences(size: int) -> Array:
    """Return the squared differences' matrix, (size, size), of a row of patches in the dark."""
    differences = np.diff(np.eye(size + 2)[:, 1:-1], axis=0)
    return differences.T @ differences
