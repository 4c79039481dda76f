"""What a user would otherwise reach for, timed beside the package's own."""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray

from periscopy_sim.reconstruction.total_variation.prox import total_variation

Array = NDArray[np.float64]


def pinv_preconditioner(A: NDArray[Any], B: Array) -> Array:
    """Return the paper's formula as it stands: the top rows of [A, B]^+."""
    return np.asarray(np.linalg.pinv(np.hstack([A, B]), rcond=1e-12)[: A.shape[1]])


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


class NumpyDifferencing:
    """Minimize ‖D(A f − y)‖² + λ‖f‖_TV, the method of [15], by FISTA in NumPy, one channel.

    D differences the photograph's columns, wrapped, and keeps its last pixel; the prox is
    scikit-image's. A fixed step, the reciprocal of the gradient's Lipschitz constant.
    """

    def __init__(self, A: Array, shape: tuple[int, int], hidden: tuple[int, int]) -> None:
        self.shape, self.hidden = shape, hidden
        self.DA = self._difference(A)
        self.gram = self.DA.T @ self.DA
        self.step = 1 / (2 * np.linalg.norm(self.gram, 2))

    def _difference(self, values: Array) -> Array:
        # Column by column, as the published code stacks a photograph.
        pixels = values.reshape(*self.shape, -1).transpose(1, 0, 2).reshape(values.shape[0], -1)
        return np.concatenate([np.diff(pixels, axis=0), pixels[-1:]])

    def solve(self, y: Array, λ: float, iterations: int) -> Array:
        """Take a number of iterations from zero; y (M,), the result (N,)."""
        from skimage.restoration import denoise_tv_chambolle

        correlation = self.DA.T @ self._difference(y[:, None])[:, 0]
        f = extrapolated = np.zeros(len(self.gram))
        t = 1.0
        for _ in range(iterations):
            moved = extrapolated - self.step * 2 * (self.gram @ extrapolated - correlation)
            new = denoise_tv_chambolle(
                moved.reshape(self.hidden), weight=self.step * λ / 2, eps=1e-6, max_num_iter=500
            ).ravel()
            t_next = (1 + np.sqrt(1 + 4 * t * t)) / 2
            extrapolated = new + (t - 1) / t_next * (new - f)
            f, t = new, t_next
        return f

    def objective(self, f: Array, y: Array, λ: float) -> float:
        """Evaluate ‖D(A f − y)‖² + λ‖f‖_TV."""
        misfit = self.DA @ f - self._difference(y[:, None])[:, 0]
        return float(misfit @ misfit) + λ * total_variation(f.reshape(self.hidden))
