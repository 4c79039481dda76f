"""Photographs as measured: signal, ambient light and noise."""

import math

import numpy as np

from periscopy_sim.numerics import Array, Image
from periscopy_sim.numerics.validation import InputError, checked, checked_number, plain_array

TARGET = 3e-4
"""Relative error of a pixel of ambient light: below a third of the noise of 60 dB."""

OWN_SHARE = 1 / 3
"""Error over the noise beyond which a line warns, of a photograph or of A: both exceed the noise by
5 %."""


def allowed_error(snr: float) -> float:
    """Return the largest relative error of its own that a photograph of an SNR, in dB, may have."""
    return float(OWN_SHARE * 10 ** (-snr / 20))


def composite(signal: Image, background: Image, sbr: float) -> Array:
    """Add ambient light at a signal-to-background ratio, at a fixed exposure (Sec. 4.1).

    Parameters
    ----------
    signal, background
        (rows, columns, channels) photographs, in any unit.
    sbr
        mean(signal) / mean(background) of the composite, over all pixels and channels; the signal
        is the monitor's light alone.

    Returns
    -------
    ndarray
        (rows, columns, channels), scaled to a mean of 1.
    """
    signal, background = (
        plain_array(each, name).astype(np.float64)
        for each, name in ((signal, "the signal"), (background, "the background"))
    )
    if signal.shape != background.shape:
        raise InputError(f"signal {signal.shape} and background {background.shape} differ in shape")
    checked("sbr", sbr, "sbr")
    if not (signal.mean() > 0 and background.mean() > 0):
        raise InputError("signal and background must have a positive mean")
    total = signal / signal.mean() + background / (background.mean() * sbr)
    return np.asarray(total / total.mean())


def composite_error(
    signal: Image, background: Image, sbr: float, of_signal: float, of_background: float
) -> float:
    """Return the relative error of a `composite` of two photographs from theirs.

    Each is a root mean square error over the photograph's own root mean square.
    """
    light, ambient = signal / np.mean(signal), background / (np.mean(background) * sbr)
    rms = [float(np.sqrt(np.mean(np.square(each)))) for each in (light, ambient, light + ambient)]
    return math.hypot(of_signal * rms[0], of_background * rms[1]) / rms[2]


def add_noise(photograph: Image, snr: float, seed: int) -> Array:
    """Add white Gaussian noise of standard deviation 10^(-SNR/20) times the root mean square.

    Parameters
    ----------
    photograph
        (rows, columns, channels), in any unit; the result is in the same.
    snr
        Signal-to-noise ratio in dB. Its signal is the whole photograph, ambient light included.
    seed
        Seed of the noise.
    """
    photograph, seed = plain_array(photograph), int(checked_number(seed, "seed", 0, whole=True))
    noise = np.random.default_rng(seed).standard_normal(photograph.shape)
    noise *= noise_level(photograph, snr)
    noise += photograph
    return noise


def noise_level(photograph: Image, snr: float) -> float:
    """Return the standard deviation of what `add_noise` adds, at a finite SNR in dB."""
    return float(
        10 ** (-checked_number(snr, "snr") / 20)
        * np.sqrt(np.mean(np.square(photograph, dtype=np.float64)))
    )


def noise_to_signal(snr: float, sbr: float) -> float:
    """Return the noise of an even photograph over the mean of its signal; the SNR is in dB."""
    return float(10 ** (-snr / 20) * (1 + 1 / sbr))
