"""The evidence that the search for a mask descends, with its prior.

    E(m) = (Σ_c F log(S_c + τ ‖y⊥_c‖²) + 3 log |A⊥ᵀA⊥ + α K| / |α K|) / κ
    S_c = min ‖y⊥_c − A⊥(m) f‖² + α fᵀK f  over f ≥ 0
    J(m) = E(m) / 2 + improbability of m,   0 ≤ m ≤ 1

One α serves all three channels, and is held while opacities move. That nothing shines negatively is
what tells most masks from the right one: without it a wrong one explains a photograph nearly as
well. The allowance τ is a fraction of the photograph that need not be explained yet: the larger,
the smoother is E, and the fewer its local minima. κ is the overdispersion.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np
from numpy.typing import NDArray
from scipy import linalg
from scipy.optimize import minimize

from periscopy_sim.calibration.evidence import image_precision
from periscopy_sim.calibration.level import Averaged
from periscopy_sim.calibration.silhouette.shadows import CellShadows
from periscopy_sim.scenario import Array

RATIOS = np.geomspace(1e-7, 1e2, 40)
"""Values of α that are tried, over the mean energy of a patch."""

LEAST = 1e-12
"""Fraction of the photograph's energy below which a misfit is rounding."""

PATIENCE = 3
"""Exchanges of all patches on the wrong side that may fail to lessen their number."""

OUTLINE = 1.0
"""Of half the evidence, a side of a cell: at Ising's critical 0.88 islands of any size are as
likely."""

CENTERED = 1.0
"""Of half the evidence, what a cell at the rectangle's border costs."""

ROUNDED = 0.05
"""Differences of opacities below which their penalty is quadratic."""

Stages = tuple[tuple[float, int], ...]
"""Allowances and how many steps are taken with each."""

Single = NDArray[np.float32]


@dataclass(frozen=True, eq=False)
class MaskFit:
    """Opacities of a mask's cells, (rows, columns), and what they explain of a photograph.

    `evidence` is E and `objective` J; images are (N, 3), the residual is (M, 3), its deviation (3,)
    `noise`.
    """

    opacities: Array
    evidence: float
    objective: float
    images: Array
    residual: Array
    noise: Array
    _at: MaskEvidence
    _projected: Single  # (M, N) A⊥
    _hessian: Array  # (N, N) A⊥ᵀA⊥ + α K
    _gradient: Array  # (K,)

    @property
    def opaque(self) -> NDArray[np.bool_]:
        """(rows, columns) whether cells are opaque rather than not."""
        return opaque(self.opacities)

    @cached_property
    def _following(self) -> list[tuple[NDArray[np.bool_], Array]]:
        """Which patches of each channel shine, and the Cholesky factor of their Hessian."""
        shine = self.images.T > 0
        return [(on, linalg.cholesky(self._hessian[np.ix_(on, on)], lower=True)) for on in shine]

    def residual_of(self, errors: Array) -> Array:
        """Return what image and light would leave of small errors, (M, 3)."""
        rest = errors - self._at.background @ (self._at.background.T @ errors)
        for c, (on, factor) in enumerate(self._following):
            A = self._projected[:, on]
            rest[:, c] -= A @ linalg.cho_solve((factor, True), A.T @ rest[:, c])
        return np.asarray(rest)

    def linearized(self) -> tuple[Array, Array]:
        """Return the gradient, (K,), and the information, (K, K), of half the evidence."""
        evidence = self._at
        light = evidence.shadows.held_off(self.images)
        deviations = self.noise * np.sqrt(evidence.overdispersion)
        light -= evidence.background @ (evidence.background.T @ light)
        total = np.zeros(2 * (len(light),))
        for c, (on, factor) in enumerate(self._following):
            J = light[:, :, c].T / deviations[c]
            followed = linalg.solve_triangular(factor, self._projected[:, on].T @ J, lower=True)
            total += J.T @ J - followed.T @ followed
        return self._gradient / 2, total


@dataclass(frozen=True, eq=False)
class MaskEvidence:
    """A photograph and the light that each cell holds off, without ambient light."""

    shadows: CellShadows
    background: Single  # (M, r) orthonormal basis of range(B)
    photograph: Array  # (M, 3) y⊥
    smoothness: Array  # (N, N) K
    overdispersion: float = 1.0  # κ

    @classmethod
    def of(
        cls, shadows: CellShadows, averaged: Averaged, background: Array, hidden: tuple[int, int]
    ) -> MaskEvidence:
        """Return that of a photograph and an orthonormal basis of range(B), (M, r)."""
        rest = averaged.light - background @ (background.T @ averaged.light)
        return cls(shadows, background.astype(np.float32), rest, image_precision(hidden))

    @property
    def freedom(self) -> int:
        """F, the pixels less the kinds of ambient light."""
        return int(len(self.photograph) - self.background.shape[1])

    @property
    def energy(self) -> Array:
        """(3,) ‖y⊥_c‖²."""
        return np.asarray(np.einsum("mc,mc->c", self.photograph, self.photograph))

    def tempered(self, overdispersion: float) -> MaskEvidence:
        """Return the evidence where the photograph counts for so much less."""
        return replace(self, overdispersion=overdispersion)

    def matrix(self, opacities: Array) -> Single:
        """Return A⊥(m), (M, N), for opacities (K,)."""
        return self._projected(self.shadows.matrix(opacities).astype(np.float32))

    def best_ratio(self, opacities: Array, allowance: float) -> float:
        """Return the α of most evidence, images of any sign, for opacities (K,)."""
        A = self.matrix(opacities)
        μ, W = linalg.eigh((A.T @ A).astype(float), self.smoothness, check_finite=False)
        μ = np.maximum(μ, 0)
        squared = (W.T @ (A.T @ self.photograph)) ** 2
        # In units of K, which is of norm about 1.
        tried = RATIOS * μ.mean()
        whole = (1 + allowance) * self.energy

        def evidence(α: float) -> float:
            left = np.maximum(whole - (squared / (μ + α)[:, None]).sum(axis=0), LEAST * whole)
            return float(self.freedom * np.log(left).sum() + 3 * np.log1p(μ / α).sum())

        return float(tried[int(np.argmin([evidence(α) for α in tried]))])

    def explain(self, opacities: Array) -> MaskFit:
        """Explain the photograph by opacities, (rows, columns)."""
        start = np.ones((len(self.smoothness), 3))
        fit = self.at(opacities, self.best_ratio(opacities.ravel(), 0.0), 0.0, start)
        return replace(fit, objective=fit.evidence / 2 + improbability(opacities)[0])

    def at(self, opacities: Array, α: float, allowance: float, start: Array) -> MaskFit:
        """Return what opacities, (rows, columns), explain; the objective lacks the prior.

        The images are sought from those of `start`, (N, 3); they do not depend on it.
        """
        A = self.matrix(opacities.ravel())
        H = (A.T @ A).astype(float) + α * self.smoothness
        correlation = (A.T @ self.photograph.astype(np.float32)).astype(float)
        factor = linalg.cholesky(H, lower=True, check_finite=False)
        volume = 2 * float(np.log(np.diag(factor)).sum()) - self._log_volume(α)
        images = np.column_stack(
            [nonnegative_fit(H, h, f) for h, f in zip(correlation.T, start.T, strict=True)]
        )
        whole = self.energy
        misfit = whole - np.einsum("nc,nc->c", images, correlation)
        left = np.maximum(misfit + allowance * whole, LEAST * whole)
        total = float(self.freedom * np.log(left / whole).sum()) + 3 * volume
        lower, _ = linalg.lapack.dpotri(factor, lower=1)
        inverse = (np.tril(lower) + np.tril(lower, -1).T).astype(np.float32)
        residual = self.photograph - A @ images
        pull = (self.freedom / left * residual).astype(np.float32) @ images.T.astype(np.float32)
        gradient = self._projected(2 * (3 * A @ inverse - pull))
        κ = self.overdispersion
        return MaskFit(
            opacities=opacities,
            evidence=total / κ,
            objective=total / κ / 2,
            images=images,
            residual=residual,
            noise=np.sqrt(left / self.freedom),
            _at=self,
            _projected=A,
            _hessian=H,
            _gradient=-self.shadows.along(gradient) / κ,
        )

    def _log_volume(self, α: float) -> float:
        """Return log |α K|."""
        return float(np.linalg.slogdet(self.smoothness)[1] + len(self.smoothness) * np.log(α))

    def _projected(self, light: Single) -> Single:
        """Return light, (M, N), with range(B) projected out."""
        return light - self.background @ (self.background.T @ light)


def descend(evidence: MaskEvidence, start: Array, stages: Stages) -> MaskFit:
    """Walk downhill from opacities, (rows, columns), and explain the photograph there.

    By a quasi-Newton method within bounds (L-BFGS-B: Byrd, Lu, Nocedal and Zhu, SIAM J. Sci.
    Comput. 16, 1995).
    """
    shape, m = start.shape, start.ravel()
    images = np.ones((len(evidence.smoothness), 3))

    def objective(m: Array, α: float, allowance: float) -> tuple[float, Array]:
        nonlocal images
        fit = evidence.at(m.reshape(shape), α, allowance, images)
        images = fit.images
        prior, slope = improbability(fit.opacities)
        return fit.objective + prior, fit._gradient / 2 + slope.ravel()

    for allowance, steps in stages:
        α = evidence.best_ratio(m, allowance)
        found = minimize(
            objective, m, args=(α, allowance), jac=True, method="L-BFGS-B",
            bounds=[(0.0, 1.0)] * len(m), options={"maxiter": steps, "maxcor": 15},
        )  # fmt: skip
        m = found.x
    return evidence.explain(np.asarray(m).reshape(shape))


def nonnegative_fit(H: Array, h: Array, start: Array) -> Array:
    """Minimize fᵀHf/2 − hᵀf over f ≥ 0, (N,), exactly, for a positive definite H.

    Block principal pivoting (Kim and Park, SIAM J. Sci. Comput. 33, 2011): all patches on the wrong
    side change sides at once, while that helps; else the last of them alone. The positive entries
    of `start`, (N,), are tried first.
    """
    positive = start > 0
    fewest, patience = len(h) + 1, PATIENCE
    tolerance = 1e-12 * float(np.abs(h).max())
    while True:
        f = np.zeros_like(h)
        if positive.any():
            factor = linalg.cho_factor(
                H[np.ix_(positive, positive)], overwrite_a=True, check_finite=False
            )
            f[positive] = linalg.cho_solve(factor, h[positive], check_finite=False)
        wrong = (f < 0) | (~positive & (H @ f - h < -tolerance))
        count = int(wrong.sum())
        if count == 0:
            return f
        if count < fewest:
            fewest, patience = count, PATIENCE
        elif patience > 0:
            patience -= 1
        else:
            wrong[: np.flatnonzero(wrong)[-1]] = False
        positive ^= wrong


def opaque(opacities: Array) -> NDArray[np.bool_]:
    """Return whether cells, (rows, columns), are opaque rather than not.

    The threshold is half of what is usual among opaque ones: a fainter mask before a brighter image
    makes nearly the same photograph.
    """
    return np.asarray(opacities > usual_opacity(opacities) / 2)


def usual_opacity(opacities: Array) -> float:
    """Return the mean opacity of cells, (rows, columns), each as often as it is opaque."""
    return float(np.sum(opacities**2) / max(float(opacities.sum()), 1e-300))


def improbability(opacities: Array) -> tuple[float, Array]:
    """Return how improbable a mask, (rows, columns), is before the photograph, and the gradient.

    Of two masks that explain a photograph alike, the one with the shorter outline is the likelier
    (Ising's model, with opacities between 0 and 1), and the one in the middle of its rectangle.
    """
    total, gradient = 0.0, np.zeros_like(opacities)
    for axis in (0, 1):
        step = np.diff(opacities, axis=axis)
        size = np.sqrt(step**2 + ROUNDED**2)
        total += OUTLINE * float((size - ROUNDED).sum())
        slope = OUTLINE * step / size
        ends = [(0, 0), (0, 0)]
        for sign, pad in ((1, (1, 0)), (-1, (0, 1))):
            ends[axis] = pad
            gradient += sign * np.pad(slope, ends)
    off = cost_of_place(opacities.shape)
    total += float(np.sum(off * opacities))
    gradient += off
    S1, S2 = float(opacities.sum()), float(np.sum(opacities**2)) + 1e-9
    ratio = S1 / S2
    return total * ratio, gradient * ratio + total * (1 / S2 - 2 * opacities * S1 / S2**2)


def cost_of_place(shape: tuple[int, ...]) -> Array:
    """Return what an opaque cell costs where it is, (rows, columns): most at the border."""
    y, x = (np.abs((np.arange(n) + 0.5) / n * 2 - 1) for n in shape)
    return np.asarray(CENTERED * np.maximum(y[:, None], x) ** 2)
