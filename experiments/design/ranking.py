"""How two rankings agree: the rank correlation, and an interval that says how sure it is."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]

RESAMPLES = 10_000
LEVEL = 0.95


@dataclass(frozen=True)
class Agreement:
    """Spearman's rank correlation of two quantities, and its interval of 95 %."""

    correlation: float
    low: float
    high: float

    def __str__(self) -> str:
        """Return both as text."""
        return f"{self.correlation:.2f} ({self.low:.2f} to {self.high:.2f})"


def agreement(one: Array, other: Array, seed: int = 0) -> Agreement:
    """Return how the ranks of two quantities of the same things agree, both (n,).

    The interval is the bootstrap's, over the things.
    """
    from scipy.stats import rankdata

    def correlations(a: Array, b: Array) -> Array:
        ranks = [rankdata(each, axis=-1) for each in (a, b)]
        x, y = (each - each.mean(axis=-1, keepdims=True) for each in ranks)
        norm = np.sqrt(np.sum(x**2, axis=-1) * np.sum(y**2, axis=-1))
        return np.asarray(np.sum(x * y, axis=-1) / np.where(norm > 0, norm, np.inf))

    drawn = np.random.default_rng(seed).integers(len(one), size=(RESAMPLES, len(one)))
    spread = correlations(one[drawn], other[drawn])
    low, high = np.quantile(spread, ((1 - LEVEL) / 2, (1 + LEVEL) / 2))
    return Agreement(float(correlations(one, other)), float(low), float(high))
