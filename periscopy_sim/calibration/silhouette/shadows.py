"""The transport matrix behind a flat mask of cells, which is linear in their opacities.

    A(o) = A₀ − Σ_k o_k A_k,   A_k[i, j] = A₀[i, j] w_ijk,

w_ijk the fraction of the rays between pixel i and patch j that cross cell k, by plain geometry, A₀
the matrix without the mask. All cells together are as sparse as the shadow of each is small.
"""

from dataclasses import dataclass
from typing import Any, Self

import numpy as np
from numpy.typing import NDArray
from scipy import sparse

from periscopy_sim.calibration.silhouette.plane import MaskPlane
from periscopy_sim.geometry import Geometry
from periscopy_sim.numerics import Array
from periscopy_sim.numerics.compilation import compiled

STEPS = 5.0
"""Rays that cross a cell, side by side, from the strata of a pixel or of a patch alone."""

FEWEST = 4
"""Strata along each side of a pixel or of a patch, at least: a ray joins any two of them."""


@dataclass(frozen=True, eq=False)
class CellShadows:
    """The light that each of K cells holds off M pixels, from each of N patches or pictures."""

    open: NDArray[np.float32]  # (M, N) A₀
    blocked: Any  # (M N, K), sparse or dense: A_k[i, j] is at (i N + j, k)

    @classmethod
    def of(
        cls,
        A: NDArray[np.float32],
        scenario: Geometry,
        plane: MaskPlane,
        cells: tuple[int, int],
        used: NDArray[np.bool_],
    ) -> Self:
        """Return those of a rectangle cut into cells; A₀ is of the pixels used, (rows, columns)."""
        rows, offsets = plane.rows_of_projection()
        scale = np.array([cells[1], cells[0], 1.0])
        rows, offsets = scale[:, None] * rows, scale * offsets
        view, hidden = scenario.view, scenario.hidden
        wall = np.concatenate([view.centers[:, None], view.edges], axis=1)[used.ravel()]
        monitor = np.stack([hidden.centers, hidden.across, hidden.up], axis=1)
        pixels, patches = wall @ rows.T, monitor @ rows.T
        pixels[:, 0] += offsets
        patches[:, 0] += offsets
        way = plane.fraction(scenario)
        strata = _strata((1 - way) * pixels), _strata(way * patches)
        parts, random = [], np.random.default_rng(0)
        for pixel, light in zip(pixels, A, strict=True):
            crossed = np.zeros((len(patches), cells[0] * cells[1]), np.float32)
            _cross(pixel, patches, *strata, *cells, random, crossed)
            parts.append(sparse.csr_array(crossed).multiply(light[:, None]).tocsr())
        return cls(A, sparse.vstack(parts, format="csr"))

    def before(self, pictures: Array) -> "CellShadows":
        """Return the light that cells hold off from J pictures, (N, J), in the place of patches."""
        N, F = self.open.shape[1], pictures.astype(np.float32)
        rows = [F.T @ self.blocked[k : k + N] for k in range(0, self.blocked.shape[0], N)]
        return CellShadows(self.open @ F, np.vstack(rows))

    @property
    def light(self) -> Array:
        """(K,) that each cell holds off, with a monitor that is white, all over the wall."""
        return np.asarray(self.blocked.sum(axis=0), np.float64)

    def matrix(self, opacities: Array) -> NDArray[np.float32]:
        """Return A(o), (M, N), for opacities (K,)."""
        blocked = self.blocked @ opacities.astype(np.float32)
        return np.asarray(self.open - blocked.reshape(self.open.shape))

    def along(self, gradient: NDArray[np.float32]) -> Array:
        """Return ⟨gradient, A_k⟩ of each cell, (K,), for a gradient (M, N)."""
        return np.asarray(self.blocked.T @ gradient.ravel(), np.float64)


def _strata(parallelograms: Array) -> tuple[int, int]:
    """Return into how many strata to cut parallelograms, (n, 3, 3), along either edge.

    The number grows with the edges' lengths in cells; each is a centre and two edges.
    """
    longest = np.abs(parallelograms[:, 1:, :2]).max(axis=(0, 2))
    first, second = (max(FEWEST, int(np.ceil(STEPS * length))) for length in longest)
    return first, second


@compiled
def _cross(
    pixel: Array,
    patches: Array,
    pixel_strata: tuple[int, int],
    patch_strata: tuple[int, int],
    rows: int,
    columns: int,
    random: np.random.Generator,
    crossed: NDArray[np.float32],
) -> None:
    """Add the fraction of the rays from a pixel to each patch that cross each cell to (N, K).

    A pixel, (3, 3), and patches, (N, 3, 3), are centres and edges in the mask's coordinates: cells
    across, cells down, off its plane. A ray goes from each stratum of the pixel to each of a patch,
    at places within them that are drawn for each patch and stratum of the pixel, so that the errors
    of entries are independent of each other.
    """
    (P, Q), (R, S) = pixel_strata, patch_strata
    share = 1.0 / (P * Q * R * S)
    for j in range(len(patches)):
        patch = patches[j]
        # Twice what parallel planes need.
        reach = np.abs(pixel[1:, :2]).sum() + np.abs(patch[1:, :2]).sum()
        t = pixel[0, 2] / (pixel[0, 2] - patch[0, 2])
        middle = pixel[0] + t * (patch[0] - pixel[0])
        if not (-reach < middle[0] < columns + reach and -reach < middle[1] < rows + reach):
            continue
        for stratum in range(P * Q):
            a, b = stratum // Q, stratum % Q
            u, v = (a + random.random()) / P - 0.5, (b + random.random()) / Q - 0.5
            p = pixel[0] + u * pixel[1] + v * pixel[2]
            shift_r, shift_s = random.random(), random.random()
            for target in range(R * S):
                r, s = target // S, target % S
                u, v = (r + shift_r) / R - 0.5, (s + shift_s) / S - 0.5
                # Where the ray from p to the patch's point crosses the plane of the cells.
                depth = patch[0, 2] + u * patch[1, 2] + v * patch[2, 2]
                t = p[2] / (p[2] - depth)
                x = p[0] + t * (patch[0, 0] + u * patch[1, 0] + v * patch[2, 0] - p[0])
                y = p[1] + t * (patch[0, 1] + u * patch[1, 1] + v * patch[2, 1] - p[1])
                if 0 <= x < columns and 0 <= y < rows:
                    crossed[j, int(y) * columns + int(x)] += share
