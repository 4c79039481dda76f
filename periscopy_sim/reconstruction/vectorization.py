"""Between images and the vectors of y = A f, for every method alike."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]
Image = NDArray[np.floating[Any]]


@dataclass(frozen=True, eq=False)
class Vectorization:
    """The sizes of photograph and hidden image, and the wall's colour.

    Make one by `vectorization_of`.

    Attributes
    ----------
    pixels
        M, of the photograph.
    hidden_shape
        (R, C) of the hidden image.
    channel_gain
        (3,) colour of the wall.
    """

    pixels: int
    hidden_shape: tuple[int, int]
    channel_gain: Array

    def vectorized(self, photograph: Image) -> Array:
        """Turn a photograph into the y of y = A f, as a grey wall would show it.

        Parameters
        ----------
        photograph
            (rows, columns, 3) or (M, 3).

        Returns
        -------
        ndarray
            (M, 3) float64, each channel divided by its gain.

        Raises
        ------
        ValueError
            If the photograph has not M pixels of 3 channels or is not finite.
        """
        photograph = np.asarray(photograph)
        if photograph.ndim < 2 or photograph.shape[-1] != 3 or photograph.size != 3 * self.pixels:
            raise ValueError(
                f"the photograph has shape {photograph.shape}; A has {self.pixels} rows, so it "
                f"must be (rows, columns, 3) with rows x columns = {self.pixels}"
            )
        y: Array = photograph.reshape(self.pixels, 3).astype(np.float64) / self.channel_gain
        if not np.isfinite(y).all():
            raise ValueError("the photograph must be finite")
        return y

    def planar(self, photographs: Image, photograph_shape: tuple[int, int] | None = None) -> Array:
        """Turn many photographs into planes, each channel's pixels side by side in memory.

        Parameters
        ----------
        photographs
            (K, rows, columns, 3) or (K, M, 3).
        photograph_shape
            (rows, columns) that they must have; None checks the number of pixels alone.

        Returns
        -------
        ndarray
            (K, 3, M) float64, each channel divided by its gain.

        Raises
        ------
        ValueError
            If a photograph has another size or is not finite.
        """
        photographs = np.asarray(photographs)
        size = photographs.shape[1:-1]
        if photograph_shape is not None and len(size) == 2 and size != tuple(photograph_shape):
            raise ValueError(
                f"the photograph has {size[0]}x{size[1]} pixels, the scene's camera "
                f"{photograph_shape[0]}x{photograph_shape[1]}"
            )
        count = len(photographs)
        if photographs.shape[-1] != 3 or np.prod(size, dtype=int) != self.pixels or not size:
            raise ValueError(
                f"the photograph has shape {photographs.shape[1:]}; A has {self.pixels} rows, so "
                f"it must be (rows, columns, 3) with rows x columns = {self.pixels}"
            )
        planes = np.moveaxis(photographs.reshape(count, self.pixels, 3), -1, 1)
        y: Array = np.divide(planes, self.channel_gain[:, None], order="C", dtype=np.float64)
        if not np.isfinite(y).all():
            raise ValueError("the photograph must be finite")
        return y

    def image(self, f: Array) -> Array:
        """Turn (N, 3) into the (R, C, 3) hidden image."""
        return f.reshape(*self.hidden_shape, 3)


def vectorization_of(
    A: Image, hidden_shape: tuple[int, int], channel_gain: Image | None = None
) -> Vectorization:
    """Check that A fits the hidden image and that the wall has a colour.

    Parameters
    ----------
    A
        (M, N) light transport matrix.
    hidden_shape
        (R, C) with R C = N.
    channel_gain
        (3,) positive colour of the wall, `Scenario.channel_gain`; None for a grey wall.

    Returns
    -------
    Vectorization

    Raises
    ------
    ValueError
        If the shapes do not fit, or the wall reflects nothing in a channel.
    """
    if hidden_shape[0] * hidden_shape[1] != A.shape[1]:
        raise ValueError(
            f"a hidden image of {hidden_shape[0]}x{hidden_shape[1]} patches does not fit A's "
            f"{A.shape[1]} columns"
        )
    gain = np.ones(3) if channel_gain is None else np.asarray(channel_gain, np.float64)
    if gain.shape != (3,) or not (gain > 0).all():
        raise ValueError(f"the wall's channel gains must be three positive numbers, not {gain}")
    return Vectorization(len(A), hidden_shape, gain)
