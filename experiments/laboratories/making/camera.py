"""What a camera makes of the wall's light: its lens, and its sensor's counts."""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]


@dataclass(frozen=True)
class Camera:
    """A colour camera of 14 bits.

    Positions are relative to the picture's centre, in units of half its diagonal.

    Attributes
    ----------
    vignetting
        Part of the light that the picture's corners lose.
    sensitivity
        (3,) of the channels.
    black, white
        Counts without light, and the highest count.
    exposure
        Count of the picture's 99.9th percentile, as a part of the white one.
    read_noise
        Counts.
    """

    vignetting: float = 0.27
    sensitivity: tuple[float, float, float] = (0.62, 1.0, 0.71)
    black: int = 512
    white: int = 16383
    exposure: float = 0.8
    read_noise: float = 3.0

    def lens(self, positions: Array) -> Array:
        """Return the part of the light that the lens lets through at (n, 2) positions."""
        return 1 - self.vignetting * np.minimum((positions**2).sum(axis=1), 1)

    def counts_per_radiance(self, radiance: Array) -> float:
        """Return the exposure of a picture (rows, columns, 3), vignetting included."""
        brightest = np.percentile(radiance * self.sensitivity, 99.9)
        return self.exposure * (self.white - self.black) / float(brightest)

    def expose(self, radiance: Array, gain: float, noise: float, seed: int) -> NDArray[np.uint16]:
        """Take a picture of radiance behind the lens, (rows, columns, 3).

        The gain is that of `counts_per_radiance`, the noise the variance of the shot noise in
        counts for each count of signal.
        """
        signal = gain * radiance * self.sensitivity
        rng = np.random.default_rng(seed)
        variance = noise * signal + self.read_noise**2
        counts = self.black + signal + rng.standard_normal(signal.shape) * np.sqrt(variance)
        return np.clip(np.rint(counts), 0, self.white).astype(np.uint16)
