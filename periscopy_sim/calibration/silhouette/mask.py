"""The mask behind which images make photographs: a descent on its evidence.

    y_pc = g ∘ (A₀ − Σ_k o_k A_k) f_pc + B b_pc + n_pc,   g = exp(SPREAD Σ_j a_j p_j),   0 ≤ o ≤ 1
    J(o, a) = Σ_p E_p(g ∘ A(o)) / 2 + outline(o) + Σ_j a_j² / 2

E_p is twice the negative logarithm of the likelihood of the p-th photograph, whose image is known
but for the mixture of its colours (`known_pictures`) or unknown (`unknown`). p_j are polynomials of
degree 1 and 2 over the wall. Without g the mask makes up for the falloff that the scene lacks.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray
from scipy.optimize import minimize

from periscopy_sim.calibration.evidence import Matrix, SmoothImages
from periscopy_sim.calibration.resolution_level import DEGREE, SPREAD
from periscopy_sim.calibration.silhouette.shadows import CellShadows
from periscopy_sim.model.wall_gain import polynomials
from periscopy_sim.numerics import Array

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
