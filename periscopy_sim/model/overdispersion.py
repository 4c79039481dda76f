"""How much less a residual tells than white noise would, since its neighbours err together.

Uneven paint, a seam, a misplaced lamp: what a scene leaves unexplained of a photograph has a
structure. Errors that are alike over k pixels and in all three channels are one error, not 3 k; who
counts them as 3 k believes whatever scene bends to them. The residual's power spectrum tells: where
white noise has the same power at all frequencies, structured errors have more at some.
"""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]
Leave = Callable[[Array], Array]
"""Returns what hidden image and ambient light leave of errors, (M', 3), that each is over σ."""

DIRECTIONS = 4
"""Sectors of half a circle of directions: a seam has one direction."""

LOWEST = 4
"""Cycles along the longer side of the photograph from which directions are told apart."""

PROBES = 12
"""Draws of white noise with which the residual is compared."""

LEAST_LEFT = 0.1
"""Part of white noise that image and light must leave in a band for it to tell of the residual."""


def overdispersion_of(
    residuals: Array, leave: Leave, used: NDArray[np.bool_], seed: int = 0
) -> float:
    """Return κ: how much stronger residuals are than white noise where they are strongest, or 1.

    They are (M', 3), each over its noise, of the pixels `used`, (rows, columns). Compared are
    octaves of spatial frequency in four directions, and in each the strongest mixture of the three
    channels: errors that they share count threefold. Both are compared after image and light have
    absorbed what they can: of white noise that is found out by drawing some, from the seed. Where
    they absorb nearly all, nothing can be said. Of white noise, κ is about 1.
    """
    bands = _bands(used.shape)

    def strengths(errors: Array) -> tuple[Array, Array]:
        laid = np.zeros((*used.shape, 3))
        laid[used] = errors
        spectrum = np.fft.fft2(laid, axes=(0, 1), norm="ortho")
        crossed = np.einsum("ijc,ijd->ijcd", spectrum, spectrum.conj()).real
        means = np.array([crossed[band].mean(axis=0) for band in bands])
        return np.linalg.eigvalsh(means)[:, -1], np.trace(means, axis1=1, axis2=2) / 3

    random = np.random.default_rng(seed)
    whites, left = np.empty((PROBES, len(bands))), np.zeros(len(bands))
    for draw in whites:
        draw[:], part = strengths(leave(random.standard_normal((used.sum(), 3))))
        left += part / PROBES / used.mean()
    found, _ = strengths(residuals)
    telling = left > LEAST_LEFT
    if not telling.any():
        return 1.0
    usual = whites.mean(axis=0)[telling]
    chance = (whites[:, telling] / usual).max(axis=1).mean()  # the largest of many is above 1
    return max(1.0, float((found[telling] / usual).max() / chance))


def _bands(shape: tuple[int, int]) -> list[NDArray[np.bool_]]:
    """Return octaves of spatial frequency in sectors of directions, each (rows, columns).

    The lowest frequencies are too few to be told apart: they are one band.
    """
    down, across = np.meshgrid(
        *(np.fft.fftfreq(size, 1 / max(shape)) for size in shape), indexing="ij"
    )
    frequency = np.hypot(down, across)
    octave = np.log2(np.maximum(frequency, LOWEST / 2) / LOWEST).astype(int)
    sector = np.rint(np.arctan2(down, across) * DIRECTIONS / np.pi).astype(int) % DIRECTIONS
    low = (frequency > 0) & (frequency < LOWEST)
    bands = [
        (frequency >= LOWEST) & (octave == o) & (sector == s)
        for o in range(octave.max() + 1)
        for s in range(DIRECTIONS)
    ]
    return [band for band in (low, *bands) if band.any()]
