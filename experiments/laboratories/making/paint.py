"""What a wall carries beside its colour: a roller's texture and seams, and posters."""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.ndimage import gaussian_filter, map_coordinates

Array = NDArray[np.float64]

GRID = 1e-3
"""Metres between the points at which paint is drawn."""


@dataclass(frozen=True)
class Paint:
    """A roller's work: fine texture, passes of unlike thickness, a seam.

    Attributes
    ----------
    grain
        (up, across) correlation of the texture, metres.
    passes
        Width of the roller, metres, and the share of the unevenness that its passes make.
    seam
        Where the seam runs, metres from the centre of the view along the wall's own across axis,
        how wide it is and its share.
    seed
        Of the draw.
    """

    grain: tuple[float, float] = (0.006, 0.003)
    passes: tuple[float, float] = (0.18, 0.5)
    seam: tuple[float, float, float] = (0.08, 0.008, 0.6)
    seed: int = 0

    def at(self, places: Array) -> Array:
        """Return the paint's unevenness at (n, 2) places, across and up in metres, to any scale."""
        low = places.min(axis=0) - 0.02
        columns, rows = np.ceil((places.max(axis=0) + 0.02 - low) / GRID).astype(int) + 1
        across = low[0] + GRID * np.arange(columns)
        rng = np.random.default_rng(self.seed)
        field = _field(rng, (rows, columns), self.grain)
        width, share = self.passes
        edges = across / width + 0.03 * _field(rng, (rows, 1), (0.05, 1))
        levels = rng.standard_normal(2 + int(np.ptp(edges)))
        layers = levels[(edges - edges.min()).astype(int)]
        field += share * gaussian_filter(layers, 0.002 / GRID)
        place, thickness, share = self.seam
        wobble = 0.004 * _field(rng, (rows, 1), (0.06, 1))
        field -= share * 5 * np.exp(-(((across - place - wobble) / thickness) ** 2) / 2)
        index = (places - low) / GRID
        values: Array = map_coordinates(field, index[:, ::-1].T, order=1, mode="nearest")
        return values


def _field(
    rng: np.random.Generator, shape: tuple[int, int], correlation: tuple[float, float]
) -> Array:
    """Draw a correlated Gaussian field of unit variance on the grid."""
    sigma = [c / GRID if n > 1 else 0 for c, n in zip(correlation, shape, strict=True)]
    field: Array = gaussian_filter(rng.standard_normal(shape), sigma, mode="wrap")
    return field / field.std()


@dataclass(frozen=True)
class Poster:
    """A printed sheet on the wall.

    Attributes
    ----------
    left, right, bottom, top
        Metres from the centre of the view, along the wall's own axes.
    seed
        Of what is printed.
    """

    left: float
    right: float
    bottom: float
    top: float
    seed: int = 0

    def covers(self, places: Array, margin: float = 0.0) -> NDArray[np.bool_]:
        """Return which of (n, 2) places lie on the sheet, or within a margin of it."""
        x, z = places.T
        across = (x > self.left - margin) & (x < self.right + margin)
        inside: NDArray[np.bool_] = across & (z > self.bottom - margin) & (z < self.top + margin)
        return inside

    def reflectance(self, places: Array) -> Array:
        """Return the print's reflectance at (n, 2) places, (n, 3): blocks of colour."""
        rng = np.random.default_rng(self.seed)
        blocks = rng.uniform(0.08, 0.85, (9, 9, 3))
        x = (places[:, 0] - self.left) / (self.right - self.left)
        z = (places[:, 1] - self.bottom) / (self.top - self.bottom)
        row, column = (np.clip(np.floor(9 * t), 0, 8).astype(int) for t in (z, x))
        colours: Array = blocks[row, column]
        return colours
