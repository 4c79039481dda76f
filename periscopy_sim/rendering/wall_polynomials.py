"""Polynomials of a photograph's row and column, and the pixels that pin them down."""

from __future__ import annotations

import numpy as np
from numpy.polynomial import legendre
from numpy.typing import NDArray

from periscopy_sim.scenario import Array

MAX_DEGREE = 12
"""Largest total degree of the polynomials tried."""


def chosen_sites(shape: tuple[int, int], count: int) -> NDArray[np.intp]:
    """Choose pixels that pin polynomials down: at most count x count, denser near the edges."""

    def along(pixels: int) -> NDArray[np.intp]:
        angle = np.pi * (np.arange(count) + 0.5) / count
        return np.unique(np.round((1 - np.cos(angle)) / 2 * (pixels - 1)).astype(np.intp))

    return (along(shape[0])[:, None] * shape[1] + along(shape[1])).ravel()


def polynomials(shape: tuple[int, int]) -> tuple[Array, NDArray[np.intp]]:
    """Products of Legendre polynomials of row and column: (M, n), and (n,) their total degrees.

    They are sorted by degree. Along a side of n pixels no polynomial beyond degree n - 1 is
    another function.
    """

    def along(pixels: int) -> Array:
        centers = (2 * np.arange(pixels) + 1) / pixels - 1
        return np.asarray(legendre.legvander(centers, MAX_DEGREE))

    down, across = along(shape[0]), along(shape[1])
    terms = [
        (degree - j, j)
        for degree in range(MAX_DEGREE + 1)
        for j in range(degree + 1)
        if degree - j < shape[0] and j < shape[1]
    ]
    basis = np.stack([np.outer(down[:, i], across[:, j]).ravel() for i, j in terms], axis=1)
    return basis, np.array([i + j for i, j in terms])
