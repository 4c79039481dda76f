"""The weight of total variation whose error is predicted to be least, from the photograph alone.

Of an estimate ẑ(z) of what a photograph would show without noise, ζ, where z − ζ is Gaussian noise
of variances v, the expected error is by Stein (Annals of Statistics 1981)

    E Σ ω (ẑ − ζ)² = E Σ ω ((ẑ − z)² − v + 2 v ∂ẑ/∂z),

for any weights ω; here the objective's own, (σ²/v)^(p/2). The derivatives are told by random
changes of z, ε√v ξ (Ramani, Blu, Unser, IEEE Trans. Image Processing 2008), the same for every λ:

    E Σ ω v ∂ẑ/∂z ≈ Σ ω √v ξ (ẑ(z + ε√v ξ) − ẑ(z))/ε.
"""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]
Estimate = Callable[[Array, float], Array]
"""Returns ẑ of z and of a factor on λ."""

STEP = 1.0
"""ε. With 0.1 what iterations leave of ẑ made the predicted error jump from one λ to the next."""

PROBED = 3000
"""Numbers that are changed, at least: with 126, chance made one λ in five too small by four."""

FARTHEST = 3
"""Powers of 2 that the factor may be, either way."""


def probes_of(shape: tuple[int, ...]) -> Array:
    """Return as many probes as it takes for chance to average out, (K, *shape)."""
    count = -(-PROBED // int(np.prod(shape)))
    return np.random.default_rng(0).choice([-1.0, 1.0], (count, *shape))


def best_factor(
    estimate: Estimate, z: Array, variances: Array, weights: Array, probes: Array
) -> float:
    """Return the factor on λ of least predicted error; all arrays are of one shape.

    But for the probes ξ, (K, ...), which are random, uncorrelated and of variance 1.

    It is looked for downhill from 1 in octaves; a parabola through three of them tells it.
    """
    changes = STEP * np.sqrt(variances) * probes
    known: dict[int, float] = {}

    def error(octave: int) -> float:
        if octave not in known:
            factor = 2.0**octave
            found = estimate(z, factor)
            moved = [each * (estimate(z + each, factor) - found) / STEP**2 for each in changes]
            own = (found - z) ** 2 + 2 * np.mean(moved, axis=0)
            known[octave] = float(np.sum(weights * own))
        return known[octave]

    best = 0
    for step in (1, -1):
        while abs(best + step) < FARTHEST and error(best + step) < error(best):
            best += step
    before, here, after = (error(octave) for octave in (best - 1, best, best + 1))
    # Where two octaves are equally good, it is the one midway, whichever of them counts as best.
    slope, bend = (before - after) / 2, before - 2 * here + after
    aside = np.clip(slope / bend, -1, 1) if bend > 0 else np.sign(slope)
    return float(2.0 ** (best + aside))
