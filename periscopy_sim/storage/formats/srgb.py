"""The sRGB transfer curve, IEC 61966-2-1."""

from __future__ import annotations

import numpy as np
from numpy.typing import ArrayLike, NDArray

_SLOPE = 12.92
_OFFSET = 0.055
_EXPONENT = 2.4
_LINEAR_END = 0.0031308  # of the straight piece, in linear light
_ENCODED_END = 0.04045  # of the straight piece, encoded


def srgb_encode(linear: ArrayLike) -> NDArray[np.float64]:
    """Return linear light encoded by the sRGB curve (IEC 61966-2-1:1999, clause 5.2), 1 for 1.

    Light is nominally in [0, 1]; negatives follow the straight piece.
    """
    linear = np.asarray(linear, dtype=np.float64)
    power = (1 + _OFFSET) * np.maximum(linear, _LINEAR_END) ** (1 / _EXPONENT) - _OFFSET
    return np.where(linear <= _LINEAR_END, _SLOPE * linear, power)


def srgb_bytes(linear: ArrayLike) -> NDArray[np.uint8]:
    """Return linear light, clipped to [0, 1], as 8-bit sRGB values."""
    return np.rint(255 * srgb_encode(np.clip(linear, 0, 1))).astype(np.uint8)


def srgb_decode(encoded: ArrayLike) -> NDArray[np.float64]:
    """Return the linear light of sRGB values (IEC 61966-2-1:1999, clause 5.2), 1 for 1.

    Values are nominally in [0, 1]; negatives follow the straight piece.
    """
    encoded = np.asarray(encoded, dtype=np.float64)
    power = ((np.maximum(encoded, _ENCODED_END) + _OFFSET) / (1 + _OFFSET)) ** _EXPONENT
    return np.where(encoded <= _ENCODED_END, encoded / _SLOPE, power)
