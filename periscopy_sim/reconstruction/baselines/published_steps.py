"""The steps of the published code of [15] for least squares with total variation.

References
----------
[15] Saunders, Murray-Bruce, Goyal, "Computational periscopy with an ordinary digital camera",
Nature, 2019.
Beck, Teboulle, "A fast iterative shrinkage-thresholding algorithm for linear inverse problems",
2009.
"""

import math

import numpy as np
from numpy.typing import NDArray

from periscopy_sim.reconstruction.total_variation.prox import solve_total_variation

Array = NDArray[np.float64]


def descend_as_published(
    gram: Array,
    h: Array,
    start: Array,
    weight: float,
    *,
    unit: float,
    white: float,
    first_step: float = 1e-5,
    shrinkage: float = 0.3,
    growth: float = 5.0,
    smallest_change: float = 2.4e-6,
    fewest: int = 10,
    most: int = 1100,
) -> tuple[Array, int]:
    """Return the image, (R, C), where the published code of [15] stops, and its iterations.

    Accelerated proximal gradient steps for ‖K f − b‖² + λ‖f‖_TV from the unregularized least
    squares, `start`, (R, C); G = KᵀK is (N, N), h = Kᵀb is (N,). The step may grow fivefold each
    time and is then shortened until the quadratic model, with the spectral norm of the step as an
    image, bounds the data term. After a growth the proximal operator keeps the weight of the
    shorter step, until the line search fails: this is how the published code has it, and why its
    image wanders about the minimum, by some 10 % and depending on rounding, until its iterations
    are used up. The proximal operator is solved to a relative duality gap of 1e-6, where the
    published code waits for a relative change of 1e-6.

    The numbers are those of the published code. The weight is λ ≥ 0, in [15], whose data term has
    one half, λ/2. `unit` takes K to the units of [15], to which `first_step` belongs; `white` is
    the f that is 1 there, as for `smallest_change`, the spectral norm of an image's change over N.
    """

    def product(f: Array) -> Array:
        return (gram @ f.ravel()).reshape(f.shape)

    def denoised(f: Array) -> Array:
        return solve_total_variation(f, threshold, tolerance=1e-6).image

    def is_majorized(change: Array) -> bool:  # ½‖K f − b‖², whose linear part cancels
        return float(np.sum(change * product(change))) <= _spectral_norm(change) ** 2 / step

    f = z = start
    step = first_step * unit**2
    t, threshold = 1.0, weight * step
    for iteration in range(1, most + 1):
        slope = product(z) - h.reshape(z.shape)
        trial = denoised(z - step * slope)
        while not is_majorized(trial - z):
            step *= shrinkage
            threshold = weight * step
            trial = denoised(z - step * slope)
        change, f = trial - f, trial
        if iteration > fewest and _spectral_norm(change) <= smallest_change * white * f.size:
            break
        following = (1 + math.sqrt(1 + 4 * t * t)) / 2
        z, t = f + (t - 1) / following * change, following
        step *= growth
    return f, iteration


def _spectral_norm(image: Array) -> float:
    return math.sqrt(max(float(np.linalg.eigvalsh(image @ image.T)[-1]), 0.0))
