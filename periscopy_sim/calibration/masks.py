"""A flat mask of cells between monitor and wall, and a descent on its evidence.

The transport matrix behind it is linear in the opacities o of its cells.

    A(o) = A₀ − Σ_k o_k A_k,   A_k[i, j] = A₀[i, j] w_ijk,

w_ijk the fraction of the rays between pixel i and patch j that cross cell k, by plain geometry, A₀
the matrix without the mask. All cells together are as sparse as the shadow of each is small.

`Mask` finds the opacities behind which images make photographs.

    y_pc = g ∘ (A₀ − Σ_k o_k A_k) f_pc + B b_pc + n_pc,   g = exp(SPREAD Σ_j a_j p_j),   0 ≤ o ≤ 1
    J(o, a) = Σ_p E_p(g ∘ A(o)) / 2 + outline(o) + Σ_j a_j² / 2

E_p is twice the negative logarithm of the likelihood of the p-th photograph, whose image is known
but for the mixture of its colours (`known_pictures`) or unknown. p_j are polynomials of
degree 1 to 3 over the wall. Without g the mask makes up for the falloff that the scene lacks.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from typing import Any, Self

import numpy as np
from numpy.typing import NDArray
from scipy import sparse
from scipy.ndimage import map_coordinates
from scipy.optimize import minimize

from periscopy_sim.calibration.evidence import Matrix, SmoothImages
from periscopy_sim.calibration.resolution_level import DEGREE, SPREAD
from periscopy_sim.errors import SceneError, did_you_mean
from periscopy_sim.model.wall_gain import polynomials
from periscopy_sim.numerics import Array
from periscopy_sim.numerics.products import compiled
from periscopy_sim.view import Geometry

Cells = NDArray[np.bool_]

SLENDER = 0.1
"""Thickness of a shape over its width up to which it is flat; and the cosine of the angle between
its normal and the way from monitor to wall, up to which it is edge on."""


@dataclass(frozen=True, eq=False)
class MaskPlane:
    """A rectangle cut into rows x columns of cells, row by row from its top left.

    That is the top left as one sees it who faces the wall. Lengths are in metres.
    """

    corner: Array  # (3,) the top left one
    across: Array  # (3,) along the top edge, as long as it
    down: Array  # (3,) along the left edge, as long as it

    @classmethod
    def of(cls, scenario: Geometry, name: str) -> Self:
        """Return the rectangle about the flat occluder of a name, in its middle plane.

        A SceneError says that there can be no mask.
        """
        wall, hidden = scenario.view.frame, scenario.hidden
        vertices = {o.name: o.vertices for o in scenario.view.occluders if o.vertices is not None}
        if name not in vertices:
            hint = did_you_mean(name, vertices) or f"there are {', '.join(vertices) or 'none'}"
            raise SceneError(
                f"scene '{scenario.path}': '{name}' is no occluder of flat faces; {hint}"
            )
        points, way = vertices[name], hidden.centers.mean(axis=0) - wall.center
        ahead = way / np.linalg.norm(way)
        _, sizes, axes = np.linalg.svd(points - points.mean(axis=0), full_matrices=False)
        normal = axes[2] * np.sign(axes[2] @ ahead)
        down = -wall.up + (wall.up @ normal) * normal
        down /= np.linalg.norm(down)
        axes = np.stack([np.cross(normal, down), down, normal])
        inside = points @ axes.T
        low, size = inside.min(axis=0), np.ptp(inside, axis=0)
        corner = (low + size * np.array([0, 0, 0.5])) @ axes
        plane = cls(corner, size[0] * axes[0], size[1] * axes[1])
        ends = plane.points(np.stack(np.meshgrid([0, 1], [0, 1]), axis=-1).reshape(-1, 2))
        from_wall = (ends - wall.center) @ wall.normal
        from_hidden = [
            (ends - each.centers.mean(axis=0)) @ each.normals.mean(axis=0)
            for each in hidden.values()
        ]
        flat = sizes[2] <= SLENDER * sizes[1] and normal @ ahead > SLENDER
        if not (flat and min(*size[:2], *from_wall, np.min(from_hidden)) > 0):
            raise SceneError(
                f"scene '{scenario.path}': occluder '{name}' is not flat, has no area, is edge on "
                "to the monitor, or not between monitor and wall; put a rectangle in its place "
                "that faces both"
            )
        return plane

    @property
    def sides(self) -> tuple[float, float]:
        """Its height and its width."""
        return float(np.linalg.norm(self.down)), float(np.linalg.norm(self.across))

    def square_cells(self, longest: int = 16) -> tuple[int, int]:
        """Return (rows, columns) of cells as square as can be, so many along the longer side."""
        rows, columns = (max(1, round(longest * side / max(self.sides))) for side in self.sides)
        return rows, columns

    def points(self, places: Array) -> Array:
        """Return the points, (..., 3), at places across and down, (..., 2), from 0 to 1."""
        return np.asarray(self.corner + places[..., :1] * self.across + places[..., 1:] * self.down)

    def moved(self, motion: Array) -> MaskPlane:
        """Return the rectangle moved by a vector, (3,)."""
        return MaskPlane(self.corner + motion, self.across, self.down)

    def seen_through(self, other: MaskPlane, eye: Array, opacities: Array, cells: Any) -> Array:
        """Return another mask's opacities in (rows, columns) cells of this one, parallel to it.

        Seen from a point, each cell of this one has the opacity of what it covers, between the
        middles of the other's cells.
        """
        rows, columns = ((np.arange(n) + 0.5) / n for n in cells)
        ways = self.points(np.stack(np.meshgrid(columns, rows), axis=-1)) - eye
        normal = np.cross(other.across, other.down)
        ratio = (other.corner - eye) @ normal / ((self.corner - eye) @ normal)
        projection, offsets = other.rows_of_projection()
        places = (eye + ratio * ways) @ projection.T + offsets
        coordinates = places[..., 1::-1] * opacities.shape - 0.5
        return np.asarray(
            map_coordinates(opacities, np.moveaxis(coordinates, -1, 0), order=1, mode="nearest")
        )

    def fraction(self, scenario: Geometry) -> float:
        """Return the fraction of the way from the wall to the monitor at which it stands."""
        normal = np.cross(self.across, self.down)
        wall, monitor = (
            float((points.mean(axis=0) - self.corner) @ normal)
            for points in (scenario.view.centers, scenario.hidden.centers)
        )
        return wall / (wall - monitor)

    def rows_of_projection(self) -> tuple[Array, Array]:
        """Return rows, (3, 3), and offsets, (3,), of coordinates in the rectangle.

        rows @ p + offsets is where p is across and down, from 0 to 1, and off the plane.
        """
        rows = np.linalg.inv(
            np.stack([self.across, self.down, np.cross(self.across, self.down)], axis=1)
        )
        return rows, -rows @ self.corner

    def pixels_a_cell(self, scenario: Geometry, cells: tuple[int, int]) -> float:
        """Return how many pixels, seen from a point of the monitor, the smaller cell side has.

        A SceneError says that there are fewer than two cells, or less than a pixel in each.
        """
        grid = scenario.view.centers.reshape(*scenario.photograph_shape, 3)
        steps = [np.linalg.norm(np.diff(grid, axis=k), axis=2) for k in (0, 1) if grid.shape[k] > 1]
        pixel = (1 - self.fraction(scenario)) * max(float(step.mean()) for step in steps)
        most = np.array(self.sides) / pixel
        if not (min(cells) >= 1 and max(cells) > 1 and np.all(most >= cells)):
            rows, columns = np.maximum(most, 1).astype(int)
            raise SceneError(
                f"{cells[0]}x{cells[1]} cells: a mask has two cells at least, and at most "
                f"{rows}x{columns}, one a pixel, whose shadows the photograph resolves"
            )
        return float(np.min(most / cells))


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

    def before(self, pictures: Array) -> CellShadows:
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


ROUNDED = 0.05
"""Differences of opacities below which their penalty is quadratic."""


@dataclass(frozen=True, eq=False)
class Explained:
    """P photographs of M pixels explained by a matrix A, (M, N).

    `cost` is twice the negative logarithm of their likelihood, `slope`, (M, N), the derivative of
    half of it by A. The image of the first one is (patches, 3), residuals are (P, M, 3).
    """

    cost: float
    slope: Matrix
    image: Array
    residual: Array


Likelihood = Callable[[Matrix], Explained]


@dataclass(frozen=True, eq=False)
class MaskFit:
    """Opacities of a mask's cells, (rows, columns), and what they explain.

    `gain` is that of the wall, (T,) coefficients; `objective` is J, with its `gradient` by the
    opacities and these.
    """

    opacities: Array
    gain: Array
    objective: float
    gradient: Array
    explained: Explained


@dataclass(frozen=True, eq=False)
class Mask:
    """A mask of (rows, columns) cells before M pixels of a wall with a gain."""

    cells: tuple[int, int]
    shadows: CellShadows
    terms: Array  # (T, M) SPREAD p_j

    @classmethod
    def of(cls, cells: tuple[int, int], shadows: CellShadows, used: NDArray[np.bool_]) -> Mask:
        """Return a mask whose shadows fall on the pixels used, (rows, columns)."""
        return cls(cells, shadows, SPREAD * polynomials(used.shape, 1, DEGREE)[:, used.ravel()])

    def transport(self, opacities: Array, gain: Array) -> Matrix:
        """Return g ∘ A(o), (M, N)."""
        g = np.exp(gain @ self.terms).astype(np.float32)
        return g[:, None] * self.shadows.matrix(opacities.ravel())

    def fit(self, opacities: Array, gain: Array, likelihood: Likelihood) -> MaskFit:
        """Return what opacities, (rows, columns), and a gain, (T,), explain."""
        A = self.transport(opacities, gain)
        explained = likelihood(A)
        penalty, slope = outline(opacities)
        g = np.exp(gain @ self.terms)[:, None]
        by_cell = slope.ravel() - self.shadows.along((g * explained.slope).astype(np.float32))
        by_gain = self.terms @ np.einsum("mn,mn->m", explained.slope, A) + gain
        return MaskFit(
            opacities,
            gain,
            explained.cost / 2 + penalty + float(gain @ gain) / 2,
            np.append(by_cell, by_gain),
            explained,
        )

    def descend(
        self, opacities: Array, gain: Array, likelihood: Likelihood, steps: int = 500
    ) -> MaskFit:
        """Return the fit where a descent leads, of so many steps at most (L-BFGS-B).

        No term of the gain exceeds a factor of e.
        """
        count = opacities.size
        bounds = [(0.0, 1.0)] * count + [(-1 / SPREAD, 1 / SPREAD)] * len(gain)

        def objective(point: Array) -> tuple[float, Array]:
            fit = self.fit(point[:count].reshape(self.cells), point[count:], likelihood)
            return fit.objective, fit.gradient

        end = minimize(
            objective, np.append(opacities, gain), jac=True, method="L-BFGS-B",
            bounds=bounds, options={"maxiter": steps},
        ).x  # fmt: skip
        return self.fit(np.asarray(end[:count]).reshape(self.cells), end[count:], likelihood)


def known_pictures(
    background: Array, photographs: Sequence[Array], pictures: Sequence[Array]
) -> Likelihood:
    """Return the likelihood of P photographs, (M, 3), of pictures, (N, 3), in any mixtures.

    The columns of A are the light of each picture's three colours, (M, 3 P).
    """
    columns = np.hsplit(np.eye(sum(picture.shape[1] for picture in pictures)), len(pictures))
    images = [
        replace(SmoothImages.shown(picture), basis=basis)
        for picture, basis in zip(pictures, columns, strict=True)
    ]

    def likelihood(A: Matrix) -> Explained:
        fits = [f.explain(A, background, y) for y, f in zip(photographs, images, strict=True)]
        slope = np.zeros_like(A)
        for fit in fits:
            pull = (fit.residual / fit.noise**2).astype(np.float32)
            slope += fit.volume - pull @ fit.lights.T.astype(np.float32)
        return Explained(
            sum(fit.cost for fit in fits),
            slope,
            pictures[0] @ fits[0].coefficients,
            np.array([fit.residual for fit in fits]),
        )

    return likelihood


def outline(opacities: Array) -> tuple[float, Array]:
    """Return the outline's penalty for opacities, (rows, columns), and its gradient.

    If two masks explain a photograph equally well, the mask with the shorter outline is likelier
    (Ising's model, with opacities between 0 and 1). A side of a cell counts 1: at Ising's critical
    0.88 islands of any size are as likely.
    """
    total, gradient = 0.0, np.zeros_like(opacities)
    for axis in (0, 1):
        step = np.diff(opacities, axis=axis)
        size = np.sqrt(step**2 + ROUNDED**2)
        total += float((size - ROUNDED).sum())
        gradient -= np.diff(step / size, axis=axis, prepend=0, append=0)
    return total, gradient


def opaque(opacities: Array) -> NDArray[np.bool_]:
    """Return whether cells, (rows, columns), are opaque rather than not.

    The threshold is half of what is usual among opaque ones: a fainter mask before a brighter image
    makes nearly the same photograph.
    """
    return np.asarray(opacities > usual_opacity(opacities) / 2)


def usual_opacity(opacities: Array) -> float:
    """Return the mean opacity of cells, (rows, columns), each as often as it is opaque."""
    return float(np.sum(opacities**2) / max(float(opacities.sum()), 1e-300))
