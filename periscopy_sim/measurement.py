"""Photographs as measured: signal, ambient background and sensor noise."""

import math
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

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


@dataclass(frozen=True, eq=False)
class Exposure:
    """What a sensor read, (rows, columns, channels), linear, in units of the photograph exposed.

    Black level and gain are undone. `saturated`, (channels,), counts the values in each channel
    that met the full well or the top code in any frame.
    """

    values: Array
    saturated: NDArray[np.int64]


@dataclass(frozen=True)
class Sensor:
    """A camera's sensor: photon and read noise, a full well, quantization, averaged frames.

    A frame collects Poisson(μ) electrons in each value, μ proportional to the light, and at most
    the full well; adds Gaussian read noise; and rounds to a code. The top code is the full well.
    As in cameras, a black level of at least 6 standard deviations of the read noise is added before
    the rounding and subtracted after it, so that noise about 0 is not cut off and stays unbiased.

    The model of noise is that of EMVA standard 1288 (4.0, Sec. 2), without dark current and fixed
    patterns. One gain holds for all channels; for colour filters that overlap, expose the light of
    `ColourMatrix.mix`.

    Attributes
    ----------
    electrons
        Mean electrons that a value collects in a frame, over all pixels and channels.
    read_noise
        Standard deviation in electrons.
    full_well
        Electrons at which a value saturates.
    bit_depth
        Bits of the analog-to-digital converter, 4 to 32.
    frames
        Exposures averaged, each with noise of its own; binning k sensor pixels to one value of the
        photograph does the same as k frames.
    """

    electrons: float
    read_noise: float = 2.5
    full_well: float = 10_000.0
    bit_depth: int = 12
    frames: int = 1

    def __post_init__(self) -> None:
        for name, value in vars(self).items():
            checked_number(value, f"Sensor.{name}")
        well, frames = self.full_well, float(self.frames)
        valid = {
            "full_well": (0 < well < math.inf, "a positive number"),
            "electrons": (0 < self.electrons <= well, "up to the full well; average more frames"),
            "read_noise": (0 <= self.read_noise <= well / 12, "0 to a twelfth of the full well"),
            "bit_depth": (self.bit_depth in range(4, 33), "a whole number, 4 to 32"),
            "frames": (frames >= 1 and frames.is_integer(), "a whole number above 0"),
        }
        for name, (is_valid, advice) in valid.items():
            if not is_valid:
                raise InputError(f"Sensor.{name} {getattr(self, name)}: give {advice}")

    @property
    def top_code(self) -> int:
        """Largest code of the converter."""
        return int(2**self.bit_depth - 1)

    @property
    def black_level(self) -> int:
        """Code that stands for no light."""
        margin = 6 * self.read_noise
        return math.ceil(self.top_code * margin / (self.full_well + margin))

    @property
    def step(self) -> float:
        """Electrons from one code to the next."""
        return self.full_well / (self.top_code - self.black_level)

    @property
    def snr(self) -> float:
        """Signal-to-noise ratio in dB of a flat photograph, which `add_noise` would be given.

        20 log₁₀(μ / σ) with σ² = (μ + σ_read² + step²/12) / frames: photon noise, read noise and
        rounding. It holds while the photograph stays below the full well and a frame's noise is no
        less than about half a step, so that the rounding's error is uniform.
        """
        variance = (self.electrons + self.read_noise**2 + self.step**2 / 12) / self.frames
        return 10 * math.log10(self.electrons**2 / variance)

    def expose(self, photograph: Image, seed: int, reference: float | None = None) -> Exposure:
        """Take a photograph.

        Parameters
        ----------
        photograph
            (rows, columns, channels) noise-free light, in any linear unit.
        seed
            Seed of all the noise.
        reference
            Light, in units of the photograph, that collects `electrons`: one for several
            photographs keeps their exposure the same. None for this photograph's mean.
        """
        light = np.asarray(photograph, np.float64)
        if light.ndim != 3 or not (np.isfinite(light).all() and (light >= 0).all()):
            raise InputError(
                f"light to expose, of shape {light.shape}, is not (rows, columns, channels), "
                "finite and nowhere negative: give it without noise, black level undone"
            )
        level = float(light.mean()) if reference is None else reference
        if not (np.isfinite(level) and level > 0):
            raise InputError(
                f"the light that collects {self.electrons:g} electrons must be positive, not "
                f"{level:g}: is the photograph black?"
            )
        gain = self.electrons / level
        # Twice the full well and more always saturates; beyond that Poisson variates may overflow.
        mean_electrons = np.minimum(gain * light, 2 * self.full_well + 100)
        rng = np.random.default_rng(seed)
        codes, saturated = np.zeros(light.shape), np.zeros(light.shape, bool)
        for _ in range(int(self.frames)):
            electrons = rng.poisson(mean_electrons)
            read_noise = rng.normal(0, self.read_noise, light.shape)
            voltage = np.minimum(electrons, self.full_well) + read_noise
            code = np.clip(np.rint(voltage / self.step) + self.black_level, 0, self.top_code)
            saturated |= (electrons >= self.full_well) | (code == self.top_code)
            codes += code
        values = (codes / self.frames - self.black_level) * (self.step / gain)
        return Exposure(values, saturated.sum(axis=(0, 1)))
