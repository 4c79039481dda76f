"""What a camera makes of the wall's light: lens, sensor and files."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

import numpy as np
import tifffile
from numpy.typing import NDArray
from PIL import Image

Array = NDArray[np.float64]
Counts = NDArray[np.uint16]


@dataclass(frozen=True)
class Camera:
    """A colour camera of 14 bits.

    Attributes
    ----------
    vignetting
        Part of the light that the picture's corners lose.
    distortion
        Radial: a pixel at a distance r from the picture's centre, in half diagonals, shows what an
        ideal camera shows at r (1 + distortion r²).
    sensitivity
        (3,) of the channels.
    black
        Counts without light.
    white
        Highest count.
    exposure
        Count of the picture's 99.9th percentile, as a part of the white one.
    read_noise
        Counts.
    quality
        Of the JPEG.
    """

    vignetting: float = 0.27
    distortion: float = 0.0
    sensitivity: tuple[float, float, float] = (0.62, 1.0, 0.71)
    black: int = 512
    white: int = 16383
    exposure: float = 0.8
    read_noise: float = 3.0
    quality: int = 92

    def ideal(self, positions: Array) -> Array:
        """Return where an ideal camera sees what pixels see: (n, 2) in [-1, 1]², half diagonals.

        Positions are relative to the centre, in units of half the diagonal.
        """
        return positions * (1 + self.distortion * (positions**2).sum(axis=1, keepdims=True))

    def lens(self, positions: Array) -> Array:
        """Return the part of the light that the lens lets through at (n, 2) positions."""
        return 1 - self.vignetting * np.minimum((positions**2).sum(axis=1), 1)

    def counts_per_radiance(self, radiance: Array) -> float:
        """Return the exposure of a picture (rows, columns, 3), vignetting included."""
        brightest = np.percentile(radiance * self.sensitivity, 99.9)
        return self.exposure * (self.white - self.black) / float(brightest)

    def expose(self, radiance: Array, gain: float, noise: float, seed: int) -> Counts:
        """Take a picture.

        Parameters
        ----------
        radiance
            (rows, columns, 3) behind the lens.
        gain
            Of `counts_per_radiance`.
        noise
            Variance of the shot noise in counts for each count of signal.
        seed
            Of the noise.
        """
        signal = gain * radiance * self.sensitivity
        rng = np.random.default_rng(seed)
        variance = noise * signal + self.read_noise**2
        counts = self.black + signal + rng.standard_normal(signal.shape) * np.sqrt(variance)
        return np.clip(np.rint(counts), 0, self.white).astype(np.uint16)

    def developed(self, counts: Counts) -> NDArray[np.uint8]:
        """Return a picture as a camera's JPEG shows it: black off, white balanced, sRGB, 8 bits."""
        linear = (counts.astype(float) - self.black) / (self.white - self.black)
        linear = np.clip(linear / np.array(self.sensitivity), 0, 1)
        encoded = np.where(linear <= 0.0031308, 12.92 * linear, 1.055 * linear ** (1 / 2.4) - 0.055)
        return np.rint(255 * encoded).astype(np.uint8)


def write_tiff(path: Path, counts: Counts) -> None:
    """Write counts as a 16-bit colour TIFF."""
    tifffile.imwrite(path, counts, photometric="rgb", compression="zlib", predictor=True)


def write_jpeg(path: Path, picture: NDArray[np.uint8], quality: int) -> None:
    """Write an 8-bit picture."""
    Image.fromarray(picture).save(path, quality=quality, subsampling=0)


def averaged(picture: Array, block: int) -> Array:
    """Average whole blocks of pixels."""
    rows, columns = picture.shape[0] // block, picture.shape[1] // block
    return picture.reshape(rows, block, columns, block, -1).mean(axis=(1, 3))
