"""Noise that neighbouring pixels share: smooth light that a scene lacks, or has too much.

    n_c ~ N(0, σ_c² (I + Φ diag(d) Φᵀ))

Bounces, paint and shapes that are not as their file says change light smoothly, by less than 1 %,
but by more than the mean over many pixels errs. Taken for white noise, that light moves a scene
until its shadows explain it. The columns of Φ are orthonormal waves over the wall, beyond the
ambient light. Those of one octave share one d: their variance in a residual over white noise's.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Any, TypeVar

import numpy as np
from numpy.typing import NDArray

from periscopy_sim.calibration.evidence import TINY
from periscopy_sim.numerics import Array, Mask

Real = TypeVar("Real", bound=NDArray[np.floating[Any]])

HALF_WAVES, LONG = 16, 8
"""Waves have fewer half waves across the wall, since scenes hardly explain rougher light; those of
fewer than the second share one variance, since ambient light has most of them. Both are chosen."""

NEW, PART = 0.1, 3
"""Least norm that a wave keeps beyond the ambient light and longer waves; and of how many numbers
one is a wave's at most, so that the others show white noise."""


@dataclass(frozen=True, eq=False)
class CorrelatedNoise:
    """Noise in M pixels of a wall, that varies more along F waves; see the module."""

    waves: NDArray[np.float32]  # (M, F) Φ
    octaves: NDArray[np.intp]  # (F,) of each wave
    excess: Array  # (F,) d
    freedom: int  # dimensions beyond the waves and the ambient light

    @classmethod
    def white(
        cls, pixels: Mask, background: Array, half_waves: int = HALF_WAVES
    ) -> CorrelatedNoise:
        """Return white noise in M pixels, beyond an orthonormal basis of ambient light, (M, r)."""
        lines = [
            np.cos(np.pi * np.outer(np.arange(min(n, half_waves + 1)), (np.arange(n) + 0.5) / n))
            for n in pixels.shape
        ]
        down, across = np.indices([len(each) for each in lines]).reshape(2, -1)
        number = np.hypot(down, across)
        order = np.argsort(number, kind="stable")
        dimensions = len(background) - background.shape[1]
        order = order[(number[order] > 0) & (number[order] < half_waves)]
        order = order[: dimensions // PART]
        waves = np.einsum("fr,fc->rcf", lines[0][down[order]], lines[1][across[order]])[pixels]
        waves /= np.linalg.norm(waves, axis=0)
        waves -= background @ (background.T @ waves)
        waves, triangle = np.linalg.qr(waves)
        is_new = np.abs(np.diag(triangle)) > NEW
        octaves = np.log2(np.maximum(number[order][is_new], LONG / 2)).astype(int)
        waves, count = waves[:, is_new].astype(np.float32), len(octaves)
        return cls(waves, octaves, np.zeros(count), dimensions - count)

    def whitened(self, light: Real) -> Real:
        """Return light, (M, ...), times the root of the inverse covariance over σ²."""
        if not self.excess.any():
            return light
        flat = light.reshape(len(light), -1)
        less = (1 - 1 / np.sqrt(1 + self.excess)).astype(np.float32)
        shared = self.waves @ (less[:, None] * (self.waves.T @ flat))
        return (flat - shared).reshape(light.shape).astype(light.dtype)  # type: ignore[return-value]

    def like(self, residuals: Array) -> CorrelatedNoise:
        """Return noise that varies as residuals do beyond the ambient light, (M, C).

        An octave's variance is the mean over its waves and the channels, each relative to the
        variance beyond all waves.
        """
        amplitudes = self.waves.T @ residuals
        rest = np.sum(residuals**2, axis=0) - np.sum(amplitudes**2, axis=0)
        white = np.maximum(rest / self.freedom, TINY)  # a dark channel has none
        power = np.mean(amplitudes**2 / white, axis=1)
        counts = np.bincount(self.octaves)
        variances = np.bincount(self.octaves, power) / np.maximum(counts, 1)
        return replace(self, excess=np.maximum(variances - 1, 0)[self.octaves])
