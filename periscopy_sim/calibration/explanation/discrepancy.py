"""How strong what a scene leaves unexplained of a photograph is at each scale, over white noise.

Bounced light, uneven paint, a seam, a misplaced chair: errors that neighbours share are strong at
low spatial frequencies, where pixels' own noise is not. Who takes them for white noise believes the
coarse shadows too much and the sharp ones too little. A filter that divides by the root of their
spectrum makes them white (Whittle's likelihood: Ark. Mat. 2, 1953).
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from periscopy_sim.calibration.explanation.evidence import Explanation
from periscopy_sim.scenario import Array

FLOOR = 0.1
"""Of the median band's strength: in one without noise, as JPEG leaves, no error is told."""

STRUCTURED = 3.0
"""From so many times white noise on, what is left is no noise, and the user is told."""

DIRECTIONS = 3
"""Sectors of a quarter circle of directions: a seam has one direction."""

LOWEST = 4
"""Cycles along the longer side of the photograph from which directions are told apart."""

PROBES = 12
"""Draws of white noise with which the residual is compared."""

LEAST_LEFT = 0.1
"""Part of white noise that image and light must leave in a band for it to tell of the residual."""


@dataclass(frozen=True, eq=False)
class Whitening:
    """The filter that makes errors of a spectrum white, over the pixels used of a photograph.

    Its determinant is 1 where all pixels are used, so that evidences by different spectra compare.
    With a mask they do up to what its border changes.
    """

    used: NDArray[np.bool_]  # (rows, columns)
    spectrum: Array  # (rows, columns) of cosines, over that of white noise

    def __call__(self, errors: NDArray[np.floating[Any]]) -> NDArray[np.floating[Any]]:
        """Return pixels' errors, (M, K), filtered; those of pixels that are not used count as 0."""
        (down, across), shape = self._cosines(errors.dtype), self.used.shape
        laid = np.zeros((self.used.size, errors.shape[1]), errors.dtype)
        laid[self.used.ravel()] = errors
        laid = np.matmul(across, laid.reshape(*shape, -1))
        found = (down @ laid.reshape(shape[0], -1)).reshape(*shape, -1)
        found *= self._gains[..., None].astype(errors.dtype)
        found = np.matmul(across.T, found)
        found = (down.T @ found.reshape(shape[0], -1)).reshape(self.used.size, -1)
        return np.asarray(found[self.used.ravel()])

    @property
    def _gains(self) -> Array:
        """(rows, columns) by which cosines are multiplied."""
        logarithm = np.log(self.spectrum)
        return np.asarray(np.exp((logarithm.mean() - logarithm) / 2))

    @property
    def discrepancy(self) -> float:
        """How much stronger errors are than white noise of the same energy, at most."""
        return float(self.spectrum.max())

    def _cosines(self, kind: Any) -> list[NDArray[np.floating[Any]]]:
        """Return the transforms along either axis, orthogonal, in some precision."""
        from scipy import fft

        return [fft.dct(np.eye(n), axis=0, norm="ortho").astype(kind) for n in self.used.shape]


@dataclass(frozen=True, eq=False)
class WhiteNoise:
    """What image and light leave of white noise in each band of spatial frequencies.

    With it the residuals are compared, of any scene much like the one it was found by. What a
    scene's parameters would absorb as well is no discrepancy, but why they move: `left_of` returns
    what they leave of errors, (M, 3), that `Explanation.left_of` left.
    """

    used: NDArray[np.bool_]  # (rows, columns)
    strengths: Array  # (B,) in the strongest mixture of the channels
    left: Array  # (B,) part of it, in the mean of the channels
    left_of: Callable[[Array], Array]

    @classmethod
    def by(
        cls,
        explanation: Explanation,
        used: NDArray[np.bool_],
        seed: int,
        left_of: Callable[[Array], Array] = lambda errors: errors,
    ) -> WhiteNoise:
        """Return what an explanation of the pixels used, (rows, columns), leaves of some draws."""
        random = np.random.default_rng(seed)
        count = len(_bands(used.shape))
        strengths, left = np.zeros(count), np.zeros(count)
        noise = random.standard_normal((PROBES, used.sum(), 3))
        for errors in explanation.left_of(noise):
            strongest, mean = _strengths(left_of(errors), used)
            strengths += strongest / PROBES
            left += mean / PROBES / used.mean()
        return cls(used, strengths, left, left_of)

    def discrepancy(self, explanation: Explanation) -> Array:
        """Return the residual's power over that of white noise, (rows, columns) of cosines.

        Powers are means over octaves of spatial frequency in some directions, in each of the
        strongest mixture of the three channels: errors that they share count threefold. Where image
        and light absorb nearly all nothing can be said, and the strongest elsewhere is taken.
        """
        deviations = np.where(explanation.noise > 0, explanation.noise, np.inf)
        telling, spectrum = self.left > LEAST_LEFT, np.ones(self.used.shape)
        if telling.any():
            residuals = self.left_of(explanation.residuals / deviations)
            found = _strengths(residuals, self.used)[0][telling] / self.strengths[telling]
            found = np.maximum(found, FLOOR * np.median(found))
            spectrum[:] = found.max()
            bands = np.array(_bands(self.used.shape))[telling]
            for band, strength in zip(bands, found, strict=True):
                spectrum[band] = strength
        return spectrum


def _strengths(errors: Array, used: NDArray[np.bool_]) -> tuple[Array, Array]:
    """Return the power of errors, (M, 3), in each band: in the strongest mixture, in the mean."""
    from scipy import fft

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
