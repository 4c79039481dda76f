"""The mask behind which an unknown image makes a photograph: descents from random masks.

    E(o) = Σ_c F log(S_c + τ ‖y⊥_c‖²) + 3 log |A⊥ᵀA⊥ + α K| / |α K|
    S_c = min ‖y⊥_c − A⊥(o) f‖² + α fᵀ K f  over f ≥ 0
    J(o) = E(o) / 2 + improbability of o,   0 ≤ o ≤ 1

The photograph is bilinear in mask and image: a blind deconvolution, whose kernel is the mask. As
Levin et al. (IEEE TPAMI 33, 2011) advise for that, the image is integrated out while the mask is
sought. That nothing shines negatively tells most masks from the right one: without it a wrong one
explains a photograph nearly as well. α is held while opacities move. The allowance τ is a fraction
of the photograph that need not be explained yet: the larger, the smoother is E.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from scipy import linalg
from scipy.ndimage import gaussian_filter, shift, zoom
from scipy.optimize import minimize

from periscopy_sim.calibration.evidence import Matrix, smoothness
from periscopy_sim.calibration.silhouette.mask import (
    MaskFit,
    opaque,
    outline,
    overlap,
    usual_opacity,
)
from periscopy_sim.calibration.silhouette.shadows import CellShadows
from periscopy_sim.scenario import Array

RATIOS = np.geomspace(1e-7, 1e2, 40)
"""Values of α that are tried, over the mean energy of a patch."""

LEAST = 1e-12
"""Fraction of the photograph's energy below which a misfit is rounding."""

PATIENCE = 3
"""Exchanges of all patches on the wrong side that may fail to lessen their number."""

CENTERED = 1.0
"""Of half the evidence, what a cell at the rectangle's border costs."""

SMOOTH, FILLED, STEEPNESS = 1 / 6, (0.3, 0.6), 2.0
"""Of random masks: the deviation of the Gaussian that smooths them, over the cells along a side;
the fraction that is more opaque than open; the steepness of opacities by the smoothed noise."""

STARTS, FINALISTS = 12, 3
"""Random masks that the search begins with; of where they lead, looked at finely."""

WALKED = 6
"""Patches that a mask walks, at most."""

SAME, AGREEING = 0.8, 0.6
"""Overlaps from which masks are one answer: of the same cells, and one of cells twice as large."""

Stages = tuple[tuple[float, int], ...]
"""Allowances and how many steps are taken with each."""

FROM_AFAR: Stages = ((1e-1, 20), (1e-2, 20), (0.0, 30))
NEARBY: Stages = ((1e-3, 20), (0.0, 30))
GLANCE: Stages = ((0.0, 15),)
ONWARD: Stages = ((0.0, 30),)


@dataclass(frozen=True, eq=False)
class BlindPhotograph:
    """A photograph and the light that each of (rows, columns) cells holds off."""

    shadows: CellShadows
    cells: tuple[int, int]
    background: Matrix  # (M, r) orthonormal basis of range(B)
    photograph: Array  # (M, 3) y⊥
    smoothness: Array  # (N, N) K

    @classmethod
    def of(
        cls,
        shadows: CellShadows,
        cells: tuple[int, int],
        background: Array,
        photograph: Array,
        hidden: tuple[int, int],
    ) -> BlindPhotograph:
        """Prepare a photograph, (M, 3), of an image of (R, C) patches."""
        rest = photograph - background @ (background.T @ photograph)
        return cls(shadows, cells, background.astype(np.float32), rest, smoothness(hidden))

    @property
    def freedom(self) -> int:
        """F, the pixels less the kinds of ambient light."""
        return int(len(self.photograph) - self.background.shape[1])

    def best_ratio(self, opacities: Array, allowance: float = 0.0) -> float:
        """Return the α of most evidence, image of any sign, for opacities (rows, columns)."""
        A = self._projected(self.shadows.matrix(opacities.ravel()))
        μ, W = linalg.eigh((A.T @ A).astype(float), self.smoothness, check_finite=False)
        μ = np.maximum(μ, 0)
        squares = (W.T @ (A.T @ self.photograph)) ** 2
        energy = (1 + allowance) * np.sum(self.photograph**2, axis=0)

        def evidence(α: float) -> float:
            misfit = np.maximum(energy - (squares / (μ + α)[:, None]).sum(axis=0), LEAST * energy)
            return float(self.freedom * np.log(misfit).sum() + 3 * np.log1p(μ / α).sum())

        return float(min(RATIOS * μ.mean(), key=evidence))

    def explain(self, opacities: Array) -> MaskFit:
        """Return what opacities, (rows, columns), explain."""
        return self.fit(opacities, self.best_ratio(opacities))

    def fit(
        self, opacities: Array, α: float, allowance: float = 0.0, start: Array | None = None
    ) -> MaskFit:
        """Return what opacities, (rows, columns), explain with a ratio and an allowance.

        The image are sought from those of `start`, (N, 3); they do not depend on it.
        """
        A = self._projected(self.shadows.matrix(opacities.ravel()))
        H = (A.T @ A).astype(float) + α * self.smoothness
        correlation = A.T.astype(float) @ self.photograph
        factor = linalg.cholesky(H, lower=True, check_finite=False)
        volume = 2 * float(np.log(np.diag(factor)).sum())
        volume -= np.linalg.slogdet(self.smoothness)[1] + len(H) * np.log(α)
        starts = np.ones_like(correlation) if start is None else start
        image = np.column_stack(
            [nonnegative_fit(H, h, f) for h, f in zip(correlation.T, starts.T, strict=True)]
        )
        energy = np.sum(self.photograph**2, axis=0)
        misfit = energy - np.sum(image * correlation, axis=0)
        misfit = np.maximum(misfit + allowance * energy, LEAST * energy)
        evidence = float(self.freedom * np.log(misfit / energy).sum()) + 3 * volume
        inverse = linalg.cho_solve((factor, True), np.eye(len(H)))
        residual = self.photograph - A @ image
        pull = (self.freedom / misfit * residual).astype(np.float32) @ image.T.astype(np.float32)
        slope = self._projected(3 * A @ inverse.astype(np.float32) - pull)
        prior, prior_slope = improbability(opacities)
        return MaskFit(
            opacities=opacities,
            evidence=evidence,
            objective=evidence / 2 + prior,
            gradient=prior_slope.ravel() - self.shadows.along(slope),
            image=image,
            residual=residual[None],
        )

    def descend(self, opacities: Array, stages: Stages) -> MaskFit:
        """Return where a descent from opacities, (rows, columns), leads (L-BFGS-B)."""
        image: Array | None = None

        def objective(o: Array, α: float, allowance: float) -> tuple[float, Array]:
            nonlocal image
            fit = self.fit(o.reshape(self.cells), α, allowance, image)
            image = fit.image
            return fit.objective, fit.gradient

        for allowance, steps in stages:
            α = self.best_ratio(opacities, allowance)
            end = minimize(
                objective, opacities.ravel(), args=(α, allowance), jac=True, method="L-BFGS-B",
                bounds=[(0.0, 1.0)] * opacities.size, options={"maxiter": steps, "maxcor": 15},
            )  # fmt: skip
            opacities = np.asarray(end.x).reshape(self.cells)
        return self.explain(opacities)

    def walk(self, fit: MaskFit, steps: Array) -> MaskFit:
        """Return where opacities lead from which no shift by one of `steps`, (2, 2), gains.

        Shifted against each other by a patch, mask and image explain a photograph nearly as well: a
        descent ends at any of these places, with edges that are frayed at most of them. A glance at
        each of the eight about one tells which is the best.
        """
        moves = [np.array([a, b]) @ steps for a in (-1, 0, 1) for b in (-1, 0, 1) if a or b]
        for _ in range(WALKED):
            around = [self.descend(shift(fit.opacities, by, order=1), GLANCE) for by in moves]
            best = self.descend(min(around, key=_objective).opacities, ONWARD)
            if best.objective > fit.objective - 1:
                return fit
            fit = best
        return fit

    def _projected(self, light: Matrix) -> Matrix:
        """Return light, (M, N), with range(B) projected out."""
        return light - self.background @ (self.background.T @ light)


def search(
    coarse: BlindPhotograph,
    fine: BlindPhotograph,
    steps: Array,
    seed: int,
    report: Callable[[float], None],
) -> tuple[MaskFit, int]:
    """Return the best mask, and how many of the starts ended at it.

    `steps`, (2, 2), are the fine cells, down and across, by which a mask moves where its image
    moves by a patch up or across.
    """
    random = np.random.default_rng(seed)
    ends: list[MaskFit] = []
    for k in range(STARTS):
        ends.append(coarse.descend(smooth_mask(coarse.cells, random), FROM_AFAR))
        report(0.4 * (k + 1) / STARTS)
    kept: list[MaskFit] = []
    for end in sorted(ends, key=_objective):
        if all(overlap(opaque(end.opacities), opaque(k.opacities)) < SAME for k in kept):
            kept.append(end)
    fits = []
    for k, end in enumerate(kept[:FINALISTS]):
        start = np.minimum(resized(end.opacities, fine.cells) / usual_opacity(end.opacities), 1.0)
        fits.append(fine.walk(fine.descend(start, NEARBY), steps))
        report(0.4 + 0.6 * (k + 1) / FINALISTS)
    best = min(fits, key=_objective)
    masks = [opaque(resized(end.opacities, fine.cells)) for end in ends]
    return best, sum(overlap(mask, opaque(best.opacities)) >= AGREEING for mask in masks)


def _objective(fit: MaskFit) -> float:
    return fit.objective


def smooth_mask(cells: tuple[int, int], random: np.random.Generator) -> Array:
    """Return a random mask, (rows, columns), of a few smooth pieces.

    One of small dots, before an image of the mask's shadow, is where rougher starts end.
    """
    noise = gaussian_filter(random.standard_normal(cells), SMOOTH * np.array(cells), mode="reflect")
    height = noise - np.quantile(noise, 1 - random.uniform(*FILLED))
    return np.asarray(1 / (1 + np.exp(-STEEPNESS * height / max(float(noise.std()), 1e-300))))


def resized(opacities: Array, cells: tuple[int, int]) -> Array:
    """Return opacities on a grid of other cells, (rows, columns): those of the nearest ones."""
    factors = np.divide(cells, opacities.shape)
    return np.asarray(zoom(opacities, factors, order=0, grid_mode=True, mode="nearest"))


def improbability(opacities: Array) -> tuple[float, Array]:
    """Return how improbable a mask, (rows, columns), is before the photograph, and the gradient.

    Of two masks that explain a photograph alike, the one with the shorter outline is the likelier,
    and the one in the middle of its rectangle. A fainter mask is as likely: else every mask would
    fade, as a brighter image makes up for it.
    """
    total, gradient = outline(opacities)
    y, x = (np.abs((np.arange(n) + 0.5) / n * 2 - 1) for n in opacities.shape)
    place = CENTERED * np.maximum(y[:, None], x) ** 2
    total += float(np.sum(place * opacities))
    gradient += place
    first, second = float(opacities.sum()), float(np.sum(opacities**2)) + 1e-9
    ratio = first / second
    slope = 1 / second - 2 * opacities * first / second**2
    return total * ratio, gradient * ratio + total * slope


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
            f[positive] = linalg.solve(H[np.ix_(positive, positive)], h[positive], assume_a="pos")
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
