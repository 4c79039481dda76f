"""How strong a residual is at each scale, over white noise, and the filter that makes it white.

Bounced light, uneven paint, a seam, a misplaced chair: errors that neighbours share are strong at
low spatial frequencies, where pixels' own noise is not. Whoever takes them for white noise trusts
the coarse shadows too much and the sharp ones too little. A filter that divides by the root of
their spectrum makes them white (Whittle's likelihood: Ark. Mat. 2, 1953).
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from functools import cached_property
from typing import Any, Protocol

import numpy as np
from numpy.typing import NDArray
from scipy import fft

Array = NDArray[np.float64]

FLOOR = 0.1
"""Fraction of the median band's strength: JPEG leaves bands without noise, of which no error is
known."""

STRUCTURED = 3.0
"""Times white noise from which a residual is no noise; users are warned."""

DIRECTIONS = 3
"""Sectors of a quarter circle of directions: a seam has one direction."""

LOWEST = 4
"""Cycles along the photograph's longer side from which directions are told apart."""

PROBES = 8
"""Draws of white noise with which the residual is compared."""

LEAST_LEFT = 0.1
"""Fraction of white noise that image and light must leave in a band for the band to count."""


class LeftOver(Protocol):
    """What an explanation leaves of a photograph; see `Explanation`."""

    @property
    def noise(self) -> Array:
        """(3,) deviations of the residual."""

    @property
    def residual(self) -> Array:
        """(M, 3)."""

    def residual_of(self, errors: Array) -> Array:
        """Return what would be left of small errors, (M, 3)."""


@dataclass(frozen=True, eq=False)
class Whitening:
    """The filter that makes errors of a spectrum white, over the pixels used of a photograph.

    Its determinant is 1 where all pixels are used, so that evidences by different spectra compare.
    """

    used: NDArray[np.bool_]  # (rows, columns)
    spectrum: Array  # (rows, columns) of cosines, over that of white noise

    @cached_property
    def _gains(self) -> Array:
        logarithm = np.log(self.spectrum)
        return np.asarray(np.exp((logarithm.mean() - logarithm) / 2))

    @cached_property
    def _cosines(self) -> list[Array]:
        """The orthogonal transforms along either axis."""
        return [fft.dct(np.eye(n), axis=0, norm="ortho") for n in self.used.shape]

    def __call__(self, errors: NDArray[np.floating[Any]]) -> NDArray[np.floating[Any]]:
        """Return pixels' errors, (M, K), filtered; those of unused pixels count as 0."""
        kind, shape = errors.dtype, self.used.shape
        down, across = (each.astype(kind) for each in self._cosines)
        laid = np.zeros((self.used.size, errors.shape[1]), kind)
        laid[self.used.ravel()] = errors
        laid = np.matmul(across, laid.reshape(*shape, -1))
        spectrum = (down @ laid.reshape(shape[0], -1)).reshape(*shape, -1)
        spectrum *= self._gains[..., None].astype(kind)
        spectrum = np.matmul(across.T, spectrum)
        filtered = (down.T @ spectrum.reshape(shape[0], -1)).reshape(self.used.size, -1)
        return np.asarray(filtered[self.used.ravel()])

    @property
    def discrepancy(self) -> float:
        """How much stronger errors are than white noise of the same energy, at most."""
        return float(self.spectrum.max())


@dataclass(frozen=True, eq=False)
class WhiteNoise:
    """What an explanation leaves of white noise in each band of spatial frequencies.

    Residuals of any scene much like the explanation's are compared with it. `absorb` removes from
    errors, (M, 3), what the scene's parameters would absorb: that is no discrepancy, but the reason
    why they move.
    """

    used: NDArray[np.bool_]  # (rows, columns)
    absorb: Callable[[Array], Array]
    strengths: Array  # (bands,) in the strongest mixture of the channels
    fractions: Array  # (bands,) left, in the mean of the channels

    @classmethod
    def of(
        cls,
        explanation: LeftOver,
        used: NDArray[np.bool_],
        seed: int,
        absorb: Callable[[Array], Array] = lambda errors: errors,
    ) -> WhiteNoise:
        """Return what an explanation of the pixels used, (rows, columns), leaves of some draws."""
        random = np.random.default_rng(seed)
        draws = (random.standard_normal((used.sum(), 3)) for _ in range(PROBES))
        pairs = [_strengths(absorb(explanation.residual_of(noise)), used) for noise in draws]
        strengths, means = np.mean(pairs, axis=0)
        return cls(used, absorb, strengths, means / used.mean())

    def whitening(self, explanation: LeftOver) -> Whitening:
        """Return the filter by the spectrum of an explanation's residual.

        Powers are means over octaves of spatial frequency in some directions, in each of the
        strongest mixture of the three channels: errors that they share count threefold. Where image
        and light absorb nearly all, the strongest elsewhere is taken.
        """
        deviations = np.where(explanation.noise > 0, explanation.noise, np.inf)
        telling, spectrum = self.fractions > LEAST_LEFT, np.ones(self.used.shape)
        if telling.any():
            errors = self.absorb(explanation.residual / deviations)
            powers = _strengths(errors, self.used)[0][telling] / self.strengths[telling]
            powers = np.maximum(powers, FLOOR * np.median(powers))
            spectrum[:] = powers.max()
            bands = np.array(_bands(self.used.shape))[telling]
            for band, power in zip(bands, powers, strict=True):
                spectrum[band] = power
        return Whitening(self.used, spectrum)


def _strengths(errors: Array, used: NDArray[np.bool_]) -> tuple[Array, Array]:
    """Return the power of errors, (M, 3), in each band: in the strongest mixture, in the mean."""
    laid = np.zeros((*used.shape, 3))
    laid[used] = errors
    spectrum = fft.dctn(laid, axes=(0, 1), norm="ortho")
    crossed = np.einsum("ijc,ijd->ijcd", spectrum, spectrum)
    means = np.array([crossed[band].mean(axis=0) for band in _bands(used.shape)])
    return np.linalg.eigvalsh(means)[:, -1], np.trace(means, axis1=1, axis2=2) / 3


def _bands(shape: tuple[int, int]) -> list[NDArray[np.bool_]]:
    """Return octaves of spatial frequency in sectors of directions, each (rows, columns).

    The lowest frequencies are too few to be told apart: they are one band.
    """
    down, across = np.meshgrid(
        *(np.arange(size) * max(shape) / (2 * size) for size in shape), indexing="ij"
    )
    frequency = np.hypot(down, across)
    octave = np.log2(np.maximum(frequency, LOWEST / 2) / LOWEST).astype(int)
    sector = np.arctan2(down, across) * DIRECTIONS * 2 / np.pi
    sector = np.minimum(sector.astype(int), DIRECTIONS - 1)
    low = frequency < LOWEST
    bands = [
        ~low & (octave == o) & (sector == s)
        for o in range(octave.max() + 1)
        for s in range(DIRECTIONS)
    ]
    return [band for band in (low, *bands) if band.any()]
