"""How strong noise is in each pattern of a scene, told by the spectrum of what a fit leaves.

Noise n of variance S_b at the frequencies of a band b shows in the pattern k, of unit length in the
photograph, with the variance

    v_k = Σ_b E_kb S_b,   E_kb = ⟨q_k, n_b⟩²  of white noise's part n_b in the band, on average.

S_b is the energy of what the fit leaves in the band over that of white noise which went through the
same fit. Where the fit takes nearly all, S_b is that of the next finer band.
"""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
from numpy.typing import NDArray
from scipy import fft, ndimage

Array = NDArray[np.float64]

DRAWS = 9
"""Draws of white noise, in each of which all bands are looked at."""

SMOOTHED = 15
"""Patterns of neighbouring curvature over which the variances E are averaged, against chance."""

LEAST_LEFT = 0.1
"""Of white noise in a band, that a fit leaves: where it is less, the band's noise is not told."""

FINEST = 0.36
"""Cycles a pixel above which all frequencies are one band."""


class NoiseSpectrum:
    """The bands of one scene, found once.

    Parameters
    ----------
    shape
        (rows, columns) of photographs.
    mask
        True in the M' pixels used; None for all.
    unexplained
        Returns what a fit leaves of (K, M') rows.
    shown
        Returns the (K, N') coordinates of rows along the patterns q_k, K a multiple of 3.
    """

    def __init__(
        self,
        shape: tuple[int, int],
        mask: NDArray[np.bool_] | None,
        unexplained: Callable[[Array], Array],
        shown: Callable[[Array], Array],
    ) -> None:
        self._shape = shape
        self._pixels = np.flatnonzero(np.ones(shape) if mask is None else mask)
        self._bands = bands_of(shape)
        white = np.random.default_rng(0).standard_normal((DRAWS, *shape))
        self._white = self._energies(unexplained(self._used(white))).mean(axis=0)
        told = self._white > LEAST_LEFT * self._energies(self._used(white)).mean(axis=0)
        # Bands ascend; each is told by itself or by the next that is, the last one at the worst.
        self._teller = [
            next((other for other in range(band, len(told)) if told[other]), len(told) - 1)
            for band in range(len(told))
        ]
        spectra = fft.rfft2(white)
        half = self._bands[:, : spectra.shape[-1]]
        parts = (fft.irfft2(np.where(half == band, spectra, 0), shape) for band in range(len(told)))
        responses = [np.mean(shown(self._used(part)) ** 2, axis=0) for part in parts]
        self._responses = ndimage.uniform_filter1d(np.array(responses), SMOOTHED, mode="nearest")

    def variances(self, left: Array) -> Array:
        """Return v, (K, N'), of noise that a fit leaves (K, M') rows of."""
        return np.asarray(self._strengths(left) @ self._responses)

    def _used(self, planes: Array) -> Array:
        """Return the pixels used of (K, rows, columns) planes, (K, M')."""
        return np.ascontiguousarray(planes.reshape(len(planes), -1)[:, self._pixels])

    def _strengths(self, left: Array) -> Array:
        """Return S, (K, bands); 1 of white noise of variance 1."""
        strengths: Array = self._energies(left) / np.maximum(self._white, 1e-30)
        return strengths[:, self._teller]

    def _energies(self, rows: Array) -> Array:
        """Return the energy of each of (K, M') rows in each band, (K, bands)."""
        planes = np.zeros((len(rows), self._bands.size))
        planes[:, self._pixels] = rows
        power = np.abs(fft.fft2(planes.reshape(-1, *self._shape))) ** 2
        bands = self._bands.ravel()
        return np.array([np.bincount(bands, each.ravel()) for each in power])


def bands_of(shape: tuple[int, int]) -> NDArray[np.intp]:
    """Return the half octave of each frequency of a transform of (rows, columns), from 0."""
    frequencies = np.hypot(fft.fftfreq(shape[0])[:, None], fft.fftfreq(shape[1]))
    lowest = 1.5 / max(shape)
    count = max(int(np.ceil(2 * np.log2(FINEST / lowest))), 0)
    bands = np.digitize(frequencies, lowest * 2 ** (np.arange(count) / 2))
    # Bands of a short side may be empty.
    return np.unique(bands, return_inverse=True)[1].reshape(shape)
