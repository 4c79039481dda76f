"""What a user would otherwise reach for, timed beside the package's own."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]


def scikit_image_tv(image: Array, weight: Array, iterations: int) -> Array:
    """Denoise each channel with its weight by scikit-image, with a number of iterations."""
    from skimage.restoration import denoise_tv_chambolle

    # It minimizes ½‖f − g‖² + w TV.
    channels = [
        denoise_tv_chambolle(image[..., c], weight=weight[c] / 2, eps=0, max_num_iter=iterations)
        for c in range(image.shape[-1])
    ]
    return np.stack(channels, axis=-1)


def pyproximal_tv(image: Array, weight: Array, iterations: int) -> Array:
    """Apply the prox of isotropic total variation by pyproximal, with a number of iterations."""
    import pyproximal

    channels = []
    for c in range(image.shape[-1]):
        # Its objective has ½‖f − g‖² + σ τ TV, τ the argument of prox.
        tv = pyproximal.TV(dims=image.shape[:2], sigma=weight[c] / 2, niter=iterations, rtol=0)
        channels.append(tv.prox(image[..., c].ravel(), 1.0).reshape(image.shape[:2]))
    return np.stack(channels, axis=-1)
