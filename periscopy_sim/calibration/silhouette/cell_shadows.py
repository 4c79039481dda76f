"""The transport matrix behind a flat mask of cells, which is linear in their opacities.

    A(m) = A₀ − Σ_k m_k A_k,   A_k[i, j] = A₀[i, j] w_ijk,

w_ijk the part of the rays between pixel i and patch j that cross cell k, by plain geometry, A₀ the
matrix without the mask. All cells together are as sparse as the shadow of each is small.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Self

import numpy as np
from numpy.typing import NDArray
from scipy import sparse

from periscopy_sim.calibration.silhouette.mask_plane import MaskPlane
from periscopy_sim.numerics.compilation import compiled
from periscopy_sim.scenario import Array, Scenario

STEPS = 5.0
"""Rays that cross a cell, side by side, from the strata of a pixel or of a patch alone."""

FEWEST = 4
"""Strata along each side of a pixel or of a patch: a ray joins the middles of any two of them."""


@dataclass(frozen=True, eq=False)
class CellShadows:
    """The light that each cell of a mask holds off, of the used pixels, (M, N) for each of K cells.

    `light`[e] is A_k[i, j] where `entry`[e] is i N + j and `cell`[e] is k.
    """

    open: Array  # (M, N) A₀
    cells: int  # K
    entry: NDArray[np.int64]
    cell: NDArray[np.int32]
    light: NDArray[np.float32]

    @classmethod
    def of(
        cls,
        A: Array,
        scenario: Scenario,
        plane: MaskPlane,
        cells: tuple[int, int],
        used: NDArray[np.bool_],
    ) -> Self:
        """Return those of a rectangle cut into cells; A₀ is of the pixels used, (rows, columns)."""
        rows, offsets = plane.rows_of_projection()
        scale = np.array([cells[1], cells[0], 1.0])
        rows, offsets = scale[:, None] * rows, scale * offsets
        part, monitor = plane.part(scenario), (scenario.patch_across, scenario.patch_up)
        pixels = _strata(scenario.wall_points, _pixel_edges(scenario), (1 - part) * rows[:2])
        patches = _strata(scenario.patch_centers, monitor, part * rows[:2])
        pixels = pixels[used.ravel()] @ rows.T + offsets
        entry, cell, crossed = _crossings(pixels, patches @ rows.T + offsets, *cells)
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

    def along(self, gradient: Array) -> Array:
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


def _strata(centers: Array, edges: tuple[Array, Array], cells: Array) -> Array:
    """Return the middles of equal strata of parallelograms of some edges, (n, K, 3).

    They are as many as the edges are long in cells: `cells`, (2, 3), projects lengths to these.
    """
    counts = (max(FEWEST, int(np.ceil(STEPS * np.abs(edge @ cells.T).max()))) for edge in edges)
    places = [(np.arange(count) + 0.5) / count - 0.5 for count in counts]
    a, b = (each.reshape(-1, 1) for each in np.meshgrid(*places))
    return np.asarray(centers[:, None] + a * edges[0][:, None] + b * edges[1][:, None])


@compiled
def _crossings(
    pixels: Array, patches: Array, rows: int, columns: int
) -> tuple[NDArray[np.int64], NDArray[np.int32], NDArray[np.float32]]:
    """Return which part of the rays of each entry crosses which cell: entries, cells, parts.

    Points, (M, P, 3) and (N, Q, 3), are in the mask's coordinates: cells across, cells down, off
    its plane.
    """
    M, P = pixels.shape[:2]
    N, Q = patches.shape[:2]
    rays = P * Q
    size = 1 << 20
    entry = np.empty(size, np.int64)
    cell = np.empty(size, np.int32)
    part = np.empty(size, np.float32)
    hits = np.zeros(rows * columns, np.int64)
    touched = np.empty(rays, np.int64)
    found = 0
    for i in range(M):
        for j in range(N):
            number = 0
            for p in range(P):
                px, py, pz = pixels[i, p, 0], pixels[i, p, 1], pixels[i, p, 2]
                for q in range(Q):
                    t = pz / (pz - patches[j, q, 2])
                    if not 0 < t < 1:
                        continue
                    x = px + t * (patches[j, q, 0] - px)
                    y = py + t * (patches[j, q, 1] - py)
                    if not (0 <= x < columns and 0 <= y < rows):
                        continue
                    k = int(y) * columns + int(x)
                    if hits[k] == 0:
                        touched[number] = k
                        number += 1
                    hits[k] += 1
            if found + number > size:
                size *= 2
                for_entry, for_cell, for_part = entry, cell, part
                entry = np.empty(size, np.int64)
                cell = np.empty(size, np.int32)
                part = np.empty(size, np.float32)
                entry[:found] = for_entry[:found]
                cell[:found] = for_cell[:found]
                part[:found] = for_part[:found]
            for n in range(number):
                k = touched[n]
                entry[found] = i * N + j
                cell[found] = k
                part[found] = hits[k] / rays
                hits[k] = 0
                found += 1
    return entry[:found].copy(), cell[:found].copy(), part[:found].copy()
