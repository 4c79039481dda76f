"""The method of [15] stopped where its published code stops, before the minimum.

`--method experiments/paper/as_published.py:Published` runs it. The method `differencing` solves the
same problem to convergence, in a sixth of the time.

References
----------
[15] Saunders, Murray-Bruce, Goyal, "Computational periscopy with an ordinary digital camera",
Nature, 2019.
"""

import math
from typing import Any

import numpy as np
from numpy.typing import NDArray

import periscopy_sim as ps
from periscopy_sim.hidden import Hidden
from periscopy_sim.reconstruction.total_variation import solve_total_variation

Array = NDArray[np.float64]

ENTRY, MEAN, MOST = 5e3, 0.25, 1100
"""In the units of the published code, for the chair experiment: the mean entry of A, and the mean
that a hidden image is taken to have, where it decides when it stops; its most iterations."""


class Published:
    """Recover the image of one hidden surface as the published code does.

    The constants belong to the code's units, in which the hidden image lies in [0, 1]; there the
    uniform image that fits D y best is taken to be 1/4.

    Parameters
    ----------
    scenario, A, B, mask
        Those that every method of one's own gets; see docs/own_method.md.

    Raises
    ------
    PeriscopyError
        If B shows photographs with the monitor off, which the published code does not know.
    """

    def __init__(self, scenario: Any, A: Any, B: Any = None, mask: Any = None) -> None:
        if B is not None and B.shape[1] > scenario.B.shape[1]:
            raise ps.PeriscopyError(
                "the published code knows no photographs with the monitor off; "
                "leave them out, or use the method 'differencing'"
            )
        self.method, self.mask = ps.Differencing.for_scene(scenario, A, B), mask

    def reconstruct(self, photograph: Any) -> Any:
        """Return the image, (R, C, channels), of a photograph, (rows, columns, channels)."""
        method = self.method.fitted_to(ps.Photograph(photograph, self.mask))
        return descended(method, photograph)[0]


def descended(method: ps.Differencing, photograph: Any) -> tuple[Array, NDArray[np.int64]]:
    """Return the image, (R, C, channels), and each channel's iterations, by a fitted method."""
    gram, h, start, noise, _ = method.equations(photograph)
    weight = method.tv_weight * noise * np.sqrt(np.trace(gram) / len(gram))
    unit = ENTRY / float(np.mean(method.fit.rows, dtype=np.float64))
    white = float(np.abs(h.sum(axis=0) / gram.sum()).mean()) / MEAN
    image = start.reshape(*method.hidden_shape, -1)
    iterations = np.zeros(len(noise), np.int64)
    for c in np.flatnonzero(weight).tolist():  # not of a black one
        of_channel = gram, h[:, c], image[..., c], float(weight[c])
        image[..., c], iterations[c] = descend(*of_channel, unit=unit, white=white)
    return image, iterations


def descend(
    gram: Array,
    h: Array,
    start: Array,
    weight: float,
    *,
    unit: float,
    white: float,
    most: int = MOST,
) -> tuple[Array, int]:
    """Return the image, (R, C), where the published code of [15] stops, and its iterations.

    Accelerated proximal gradient steps (Beck and Teboulle, 2009) for ‖K f − b‖² + λ‖f‖_TV from the
    least squares, `start`, (R, C); G = KᵀK is (N, N), h = Kᵀb is (N,). The step may grow fivefold
    each time and is then shortened until the quadratic model, with the spectral norm of the step as
    an image, bounds the data term. After a growth the proximal operator keeps the weight of the
    shorter step, until the line search fails: this is how the published code has it, and why its
    image wanders about the minimum, by some 10 % and depending on rounding, until its iterations
    are used up. The proximal operator is solved to a relative duality gap of 1e-6, where the
    published code waits for a relative change of 1e-6.

    The numbers are those of the published code. The weight is λ ≥ 0, in [15], whose data term has
    one half, λ/2. `unit` takes K to the units of [15], to which the first step, 1e-5, belongs;
    `white` is the f that is 1 there, as for the spectral norm of an image's change over N, 2.4e-6
    where the iterations end.
    """

    def product(f: Array) -> Array:
        return (gram @ f.ravel()).reshape(f.shape)

    def denoised(f: Array) -> Array:
        flat = solve_total_variation(f.reshape(-1, 1), threshold, hidden, tolerance=1e-6)
        return flat.image.reshape(f.shape)

    def is_majorized(change: Array) -> bool:  # ½‖K f − b‖², whose linear part cancels
        return float(np.sum(change * product(change))) <= _spectral_norm(change) ** 2 / step

    hidden, f = Hidden.of(start.shape), start
    z = f
    step = 1e-5 * unit**2
    t, threshold = 1.0, weight * step
    for iteration in range(1, most + 1):
        slope = product(z) - h.reshape(z.shape)
        trial = denoised(z - step * slope)
        while not is_majorized(trial - z):
            step *= 0.3
            threshold = weight * step
            trial = denoised(z - step * slope)
        change, f = trial - f, trial
        if iteration > 10 and _spectral_norm(change) <= 2.4e-6 * white * f.size:
            break
        following = (1 + math.sqrt(1 + 4 * t * t)) / 2
        z, t = f + (t - 1) / following * change, following
        step *= 5.0
    return f, iteration


def _spectral_norm(image: Array) -> float:
    return math.sqrt(max(float(np.linalg.eigvalsh(image @ image.T)[-1]), 0.0))
