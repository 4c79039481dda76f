"""Unknown images that are nonnegative and have few edges, and photographs explained by them.

    E = F Σ_c log ‖y⊥_c − A⊥ f̂_c‖² + 6 N log(‖A⊥‖_F V),   V = Σ ‖∇f̂‖,   f̂ ≥ 0

is twice the negative logarithm of a posterior density, less a constant, where it is largest. The
noise is white, with F dimensions beyond the ambient light and an unknown σ_c. The density of the
3 N values of an image is proportional to λ^(3 N) exp(−λ V) with an unknown λ. At the maximum

    σ_c² = ‖y⊥_c − A⊥ f̂_c‖² / F,   λ = 3 N / V,

and f̂ is the noise-aware image of σ and 2 λ. V also counts the edges to the dark beyond the
borders. Otherwise the objective favours places where part of the image lies beyond them. The
noise-aware image ignores these edges, so the slope is up to 1.45 times too large where the image is
bright at a border. ‖A⊥‖_F counts edges in units of their light on the wall: without it, the scene
that needs the darkest image would be the best. V has σ √N/‖A⊥‖_F added, the radiance of one patch
that is just visible above the noise. Without it a black image has an unbounded density, and scenes
that explain nothing would be the best.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np
from scipy import linalg

from periscopy_sim.calibration.evidence import ROUNDING, Explanation, Matrix
from periscopy_sim.hidden import Differences, Hidden
from periscopy_sim.model.uncertainty import curvature_of_total_variation
from periscopy_sim.numerics import Array
from periscopy_sim.reconstruction.noise_aware.noise_aware import NoiseAware

ROUNDS, TOLERANCE = 4, 1e-4
"""How often σ and λ are updated, and the tolerance of each image: the slope then agrees with
differences of the evidence to a tenth (`test_sharp_images`); 3 and 1e-3 left a seventh. A patch
whose light over the brightest is less than the tolerance stays dark as the scene changes."""

REGULARIZATION = 0.01
"""Regularization of the first of these images, see `NoiseAware`."""


@dataclass(frozen=True)
class SharpImages:
    """What hidden surfaces may have shown in some channels; see the module."""

    hidden: Hidden
    channels: int = 3

    def explain(self, A: Matrix, background: Array, y: Array) -> SharpExplanation:
        """Explain photographs y, (M, C K) of any unit and C channels, by a matrix A, (M, N).

        The background is an orthonormal basis of range(B), (M, r).
        """
        method = NoiseAware(
            A,
            background,
            hidden=self.hidden,
            profiles=False,
            corrections=(),
            tolerance=TOLERANCE,
        )
        freedom, dimensions = len(A) - background.shape[1], self.channels * A.shape[1]
        differences = self.hidden.differences
        darkest = ROUNDING * np.sqrt(np.mean(y**2))
        cost, images, residuals, noises = 0.0, [], [], []
        for light in y.T.reshape(-1, self.channels, len(A)):
            shown = method.fit.single_evidence(light)
            method.regularization, split = REGULARIZATION, None
            for _ in range(ROUNDS):
                solution, split = method.recover(shown, start=split)
                f = self.hidden.vector(solution.image)
                residual = method.fit.project_out(light - (A @ f).T)
                noise = np.sqrt(np.sum(residual**2, axis=1) / freedom) + darkest
                visible = float(np.sqrt(np.mean(noise**2) * A.shape[1])) / method.fit.norm
                variation = differences.variation_in_the_dark(f) + visible
                λ = 2 * dimensions / variation
                shown = replace(shown, noise=noise / shown.level, noise_to_signal=0.0)
                method.regularization = λ * float(noise.mean()) / method.fit.norm
            cost += 2 * freedom * float(np.log(noise).sum())
            cost += 2 * dimensions * np.log(method.fit.norm * variation)
            images.append(f)
            residuals.append(residual)
            noises.append(noise)
        return SharpExplanation(
            cost=cost,
            noise=np.concatenate(noises),
            lights=np.hstack(images),
            residual=np.concatenate(residuals).T.astype(np.float64),
            energy=np.sum(method.fit.project_out(y.T) ** 2, axis=1, dtype=np.float64),
            background=background,
            images=tuple(images),
            differences=differences,
            columns=A - background @ (background.T @ A),
            gram=method.fit.operator.gram,
        )


@dataclass(frozen=True, eq=False)
class SharpExplanation(Explanation):
    """Photographs explained by a transport matrix, images of few edges and ambient light."""

    images: tuple[Array, ...]  # K of (N, C) f̂
    differences: Differences  # ∇ of the images
    columns: Array  # (M, N) A⊥
    gram: Array  # (N, N) A⊥ᵀA⊥

    @cached_property
    def volume(self) -> Matrix:
        """(M, N) derivative of 3 N log ‖A⊥‖_F by the entries of A, of all photographs."""
        weight = sum(image.size for image in self.images) / np.sum(self.columns**2)
        return np.asarray(weight * self.columns, np.float32)

    def beyond_image(self, motion: Array) -> Array:
        """Return what no hidden image can follow of motions, (P, M, C).

        As for `SmoothExplanation`, with the curvature of total variation at f̂, in the patches that
        are lit.
        """
        beyond = np.empty_like(motion)
        for k, f in enumerate(self.images):
            variation = self.differences.norms(f).sum() or 1.0  # of a black image nothing is lit
            λ = 2 * f.size / variation
            stiffness = curvature_of_total_variation(self.differences, f, λ).toarray()
            for c, values in enumerate(f.T, k * f.shape[1]):
                lit = values > TOLERANCE * f.max()
                X, J = self.columns[:, lit], motion[:, :, c].T
                H = self.gram[np.ix_(lit, lit)] + self.noise[c] ** 2 * stiffness[np.ix_(lit, lit)]
                beyond[:, :, c] = (J - X @ linalg.solve(H, X.T @ J, assume_a="pos")).T
        return beyond
