"""Blocks of pixels averaged."""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray


def block_means(image: NDArray[Any], shape: tuple[int, int]) -> NDArray[np.float64]:
    """Return an image averaged over equal blocks of pixels: (rows, columns, channels).

    The image is (k rows, l columns, channels) with whole numbers k and l.
    """
    rows, columns = shape
    height, width, channels = image.shape
    blocks = image.reshape(rows, height // rows, columns, width // columns, channels)
    return np.asarray(blocks.mean(axis=(1, 3), dtype=np.float64))
