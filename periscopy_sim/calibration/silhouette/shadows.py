"""The transport matrix behind a flat mask of cells, which is linear in their opacities.

    A(m) = A₀ − Σ_k m_k A_k,   A_k[i, j] = A₀[i, j] w_ijk,

w_ijk the part of the rays between pixel i and patch j that cross cell k, by plain geometry, A₀ the
matrix without the mask. All cells together are as sparse as the shadow of each is small.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any, Self

import numpy as np
from numpy.typing import NDArray
from scipy import sparse

from periscopy_sim.calibration.silhouette.plane import MaskPlane
from periscopy_sim.numerics.compilation import compiled
from periscopy_sim.scenario import Array, Scenario

STEPS = 5.0
"""Rays that cross a cell, side by side, from the strata of a pixel or of a patch alone."""

FEWEST = 4
"""Strata along each side of a pixel or of a patch: a ray joins the middles of any two of them."""


LAST = (1 << 32) - 1
"""The largest of 32 random bits."""


@dataclass(frozen=True, eq=False)
class CellShadows:
    """The light that each cell of a mask holds off, of the used pixels, (M, N) for each of K cells.

    `light`[e] is A_k[i, j] where `entry`[e] is i N + j and `cell`[e] is k.
    """

    open: NDArray[np.floating[Any]]  # (M, N) A₀
    cells: int  # K
    entry: NDArray[np.int64]
    cell: NDArray[np.int32]
    light: NDArray[np.float32]

    @classmethod
    def of(
        cls,
        A: NDArray[np.floating[Any]],
        scenario: Scenario,
        plane: MaskPlane,
        cells: tuple[int, int],
        used: NDArray[np.bool_],
    ) -> Self:
        """Return those of a rectangle cut into cells; A₀ is of the pixels used, (rows, columns)."""
        rows, offsets = plane.rows_of_projection()
        scale = np.array([cells[1], cells[0], 1.0])
        rows, offsets = scale[:, None] * rows, scale * offsets
        part = plane.part(scenario)
        wall = np.stack([scenario.wall_points, *_pixel_edges(scenario)], axis=1)[used.ravel()]
        monitor = np.stack(
            [scenario.patch_centers, scenario.patch_across, scenario.patch_up], axis=1
        )
        pixels, patches = wall @ rows.T, monitor @ rows.T
        pixels[:, 0] += offsets
        patches[:, 0] += offsets
        entry, cell, crossed = _crossings(
            pixels, patches, _strata((1 - part) * pixels), _strata(part * patches), *cells
        )
        light = (A.ravel()[entry] * crossed).astype(np.float32)
        return cls(A, cells[0] * cells[1], entry, cell, light)

    @property
    def light_held_off(self) -> Array:
        """(K,) of each cell, with a monitor that is white, all over the wall."""
        return np.asarray(
            np.bincount(self.cell, weights=self.light, minlength=self.cells), np.float64
        )

    def matrix(self, opacities: Array) -> Array:
        """Return A(m), (M, N), for opacities (K,)."""
        held = np.bincount(
            self.entry, weights=self.light * opacities[self.cell], minlength=self.open.size
        )
        return np.asarray(self.open - held.reshape(self.open.shape))

    def held_off(self, images: Array) -> Array:
        """Return the light A_k f that each cell holds off the wall, (K, M, 3), of images (N, 3)."""
        M, N = self.open.shape
        pixel, patch = np.divmod(self.entry, N)
        by_cell = sparse.csr_array(
            (self.light, (self.cell * np.int64(M) + pixel, patch)), shape=(self.cells * M, N)
        )
        return np.asarray((by_cell @ images).reshape(self.cells, M, -1))

    def along(self, gradient: NDArray[np.floating[Any]]) -> Array:
        """Return ⟨gradient, A_k⟩ of each cell, (K,), for a gradient (M, N)."""
        weights = self.light * gradient.ravel()[self.entry]
        return np.asarray(np.bincount(self.cell, weights, self.cells), np.float64)


def _pixel_edges(scenario: Scenario) -> tuple[Array, Array]:
    """Return each pixel's edge vectors on the wall, across and down, (M, 3), by differences."""
    rows, columns = scenario.photograph_shape
    grid = scenario.wall_points.reshape(rows, columns, 3)

    def along(axis: int) -> Array:
        edges = np.gradient(grid, axis=axis) if grid.shape[axis] > 1 else np.zeros_like(grid)
        return np.asarray(edges).reshape(-1, 3)

    return along(1), along(0)


def _strata(parallelograms: Array) -> tuple[int, int]:
    """Return into how many strata to cut parallelograms, (n, 3, 3), along either edge.

    As many as the edges are long, in cells; each is a centre and two edges.
    """
    longest = np.abs(parallelograms[:, 1:, :2]).max(axis=(0, 2))
    along, up = (max(FEWEST, int(np.ceil(STEPS * length))) for length in longest)
    return along, up


@compiled
def _near(pixel: Array, patch: Array, rows: int, columns: int) -> bool:
    """Return whether rays between a pixel and a patch, (3, 3) each, may cross the mask."""
    t = pixel[0, 2] / (pixel[0, 2] - patch[0, 2])
    reach = 0.0
    for d in range(2):
        for e in range(1, 3):
            reach += abs(pixel[e, d]) + abs(patch[e, d])  # twice what parallel planes need
    x, y = pixel[0, :2] + t * (patch[0, :2] - pixel[0, :2])
    return bool(-reach < x < columns + reach and -reach < y < rows + reach)


@compiled
def _longer(values: NDArray[Any]) -> NDArray[Any]:
    """Return an array of twice the length, with the values first."""
    longer = np.empty(2 * len(values), values.dtype)
    longer[: len(values)] = values
    return longer


@compiled
def _crossings(
    pixels: Array,
    patches: Array,
    pixel_strata: tuple[int, int],
    patch_strata: tuple[int, int],
    rows: int,
    columns: int,
) -> tuple[NDArray[np.int64], NDArray[np.int32], NDArray[np.float32]]:
    """Return which part of the rays of each entry crosses which cell: entries, cells, parts.

    Pixels and patches, (M, 3, 3) and (N, 3, 3), are centres and edges in the mask's coordinates:
    cells across, cells down, off its plane. A ray goes from each stratum of a pixel to each of a
    patch, shifted within it by a random number for each entry and stratum of the pixel: so the
    errors of entries are independent of each other.
    """
    M, N = len(pixels), len(patches)
    rays = pixel_strata[0] * pixel_strata[1] * patch_strata[0] * patch_strata[1]
    size = 1 << 20
    entry, cell = np.empty(size, np.int64), np.empty(size, np.int32)
    part = np.empty(size, np.float32)
    hits = np.zeros(rows * columns, np.int64)
    touched = np.empty(rays, np.int64)
    found, bits = 0, 1
    shift = np.empty(4)
    p, q = np.empty(3), np.empty(3)
    for i in range(M):
        for j in range(N):
            if not _near(pixels[i], patches[j], rows, columns):
                continue
            number = 0
            for n in range(pixel_strata[0] * pixel_strata[1]):
                for d in range(4):  # xorshift (Marsaglia, J. Stat. Softw. 8, 2003)
                    bits ^= (bits << 13) & LAST
                    bits ^= bits >> 17
                    bits ^= (bits << 5) & LAST
                    shift[d] = bits / LAST
                a = (n // pixel_strata[1] + shift[0]) / pixel_strata[0] - 0.5
                b = (n % pixel_strata[1] + shift[1]) / pixel_strata[1] - 0.5
                for d in range(3):
                    p[d] = pixels[i, 0, d] + a * pixels[i, 1, d] + b * pixels[i, 2, d]
                for m in range(patch_strata[0] * patch_strata[1]):
                    a = (m // patch_strata[1] + shift[2]) / patch_strata[0] - 0.5
                    b = (m % patch_strata[1] + shift[3]) / patch_strata[1] - 0.5
                    for d in range(3):
                        q[d] = patches[j, 0, d] + a * patches[j, 1, d] + b * patches[j, 2, d]
                    t = p[2] / (p[2] - q[2])
                    x, y = p[0] + t * (q[0] - p[0]), p[1] + t * (q[1] - p[1])
                    if not (0 < t < 1 and 0 <= x < columns and 0 <= y < rows):
                        continue
                    k = int(y) * columns + int(x)
                    if hits[k] == 0:
                        touched[number] = k
                        number += 1
                    hits[k] += 1
            if found + number > size:
                size *= 2
                entry, cell, part = _longer(entry), _longer(cell), _longer(part)
            for n in range(number):
                k = touched[n]
                entry[found], cell[found], part[found] = i * N + j, k, hits[k] / rays
                hits[k] = 0
                found += 1
    return entry[:found].copy(), cell[:found].copy(), part[:found].copy()
