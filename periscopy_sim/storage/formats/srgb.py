"""The sRGB transfer curve, IEC 61966-2-1:1999, clause 5.2: 1 for 1, straight near 0."""

import numpy as np
from numpy.typing import ArrayLike, NDArray


def srgb_encode(linear: ArrayLike) -> NDArray[np.float64]:
    """Return linear light, nominally in [0, 1], encoded; negatives follow the straight piece."""
    linear = np.asarray(linear, dtype=np.float64)
    power = 1.055 * np.maximum(linear, 0.0031308) ** (1 / 2.4) - 0.055
    return np.where(linear <= 0.0031308, 12.92 * linear, power)


def srgb_bytes(linear: ArrayLike) -> NDArray[np.uint8]:
    """Return linear light, clipped to [0, 1], as 8-bit sRGB values."""
    return np.rint(255 * srgb_encode(np.clip(linear, 0, 1))).astype(np.uint8)


def srgb_decode(encoded: ArrayLike) -> NDArray[np.float64]:
    """Return the linear light of sRGB values, nominally in [0, 1]; `srgb_encode` undone."""
    encoded = np.asarray(encoded, dtype=np.float64)
    power = ((np.maximum(encoded, 0.04045) + 0.055) / 1.055) ** 2.4
    return np.where(encoded <= 0.04045, encoded / 12.92, power)


def srgb_light(codes: NDArray[np.unsignedinteger]) -> NDArray[np.float64]:
    """Return the linear light of 8- or 16-bit sRGB values, 1 for the largest, by a table."""
    white = np.iinfo(codes.dtype).max
    return np.asarray(srgb_decode(np.arange(white + 1) / white)[codes])
