"""Photographs as measured: signal, ambient background and sensor noise."""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]
Image = NDArray[np.floating[Any]]


def composite(signal: Image, background: Image, sbr: float) -> Array:
    """Add ambient light at a signal-to-background ratio, at a fixed exposure (Sec. 4.1).

    Parameters
    ----------
    signal, background
        (rows, columns, 3) photographs, in any unit.
    sbr
        mean(signal) / mean(background) of the composite, over all pixels and channels.

    Returns
    -------
    ndarray
        (rows, columns, 3), scaled to a mean of 1.

    Raises
    ------
    ValueError
        If the shapes differ, the SBR is not positive, or a photograph has not a positive mean.
    """
    if signal.shape != background.shape:
        raise ValueError(f"signal {signal.shape} and background {background.shape} differ in shape")
    if not (np.isfinite(sbr) and sbr > 0):
        raise ValueError(f"the signal-to-background ratio must be positive, not {sbr}")
    if not (signal.mean() > 0 and background.mean() > 0):
        raise ValueError("signal and background must have a positive mean")
    signal, background = np.asarray(signal, np.float64), np.asarray(background, np.float64)
    total = signal / signal.mean() + background / (background.mean() * sbr)
    exposed: Array = total / total.mean()
    return exposed


def add_noise(photograph: Image, snr: float, seed: int) -> Array:
    """Add white Gaussian noise of standard deviation 10^(-SNR/20) times the root mean square.

    Parameters
    ----------
    photograph
        (rows, columns, 3), in any unit.
    snr
        Signal-to-noise ratio in dB.
    seed
        Seed of the noise.

    Returns
    -------
    ndarray
        (rows, columns, 3).

    Raises
    ------
    ValueError
        If the SNR is not finite.
    """
    if not np.isfinite(snr):
        raise ValueError(f"the signal-to-noise ratio must be finite, not {snr} dB")
    σ = 10 ** (-snr / 20) * np.sqrt(np.mean(np.square(photograph, dtype=np.float64)))
    noisy: Array = photograph + np.random.default_rng(seed).normal(0, σ, photograph.shape)
    return noisy
