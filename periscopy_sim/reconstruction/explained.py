"""Whether a photograph shows anything of a scene, by what the scene explains of it."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]

LEAST_SHARE = 1e-6
"""Of a photograph, range(B) projected out: where less is left, it is no more than rounding."""

SIGNIFICANT = 3
"""Standard errors of noise: what A⊥ can explain of a photograph is more, or it is noise."""

LEAST_EXPLAINED = 0.2
"""Of what A⊥ can explain of a photograph: where the image explains less, it is mostly noise."""


@dataclass(frozen=True, eq=False)
class Explained:
    """A photograph y, explained by a hidden image f̂ and ambient light."""

    share: float  # root mean square of y⊥, range(B) projected out of y, over that of y
    whole: Array  # (3,) energy that A⊥ can explain of y⊥, over its noise's variance
    left: Array  # (3,) what f̂ leaves of that
    patterns: int  # hidden images that the wall tells apart, the rank of A⊥

    @property
    def doubt(self) -> str:
        """Why y may show nothing of a hidden image; empty where nothing says so."""
        if self.share < LEAST_SHARE:
            return "the photograph shows no hidden image: ambient light alone explains all of it"
        whole, left, count = self.whole.sum(), self.left.sum(), 3 * self.patterns
        is_noise = whole - count < SIGNIFICANT * np.sqrt(2 * count)
        if is_noise or whole - left < LEAST_EXPLAINED * whole:
            return (
                "the photograph hardly shows a hidden image: what the scene explains of it is no "
                "more than noise"
            )
        return ""
