"""How well a transport matrix explains photographs, whatever the monitor showed.

    y_c = A S x_c + B b_c + n_c,   x_c ~ N(0, σ_c²/α_c K⁻¹),   n_c ~ N(0, σ_c² I),   b_c free

The columns of S, (N, J), are what the monitor may have shown: patches or hat functions, of which K
prefers smooth images, or the three colours of a known picture, which a camera mixes. All but A is
eliminated (variable projection: Golub and Pereyra, SIAM J. Numer. Anal. 10, 1973), x by integration
(the evidence: MacKay, Neural Comput. 4, 1992): a best fit alone would favour the A that bends to
any photograph. One number remains for each channel,

    E_c = F log S_c + Σ log(1 + μ/α_c),   S_c = ‖y⊥‖² − Σ z_c²/(μ + α_c) = F σ_c²,

twice the negative logarithm of the evidence up to a constant. F is M less the rank of B, μ and W
are the generalized eigenvalues and vectors of (X⊥ᵀX⊥, K), X = A S, z = Wᵀ X⊥ᵀ y⊥, and ⊥ projects
range(B) out. Each α_c minimizes E_c, unless x is a multiple s of a typical m but for a deviation in
proportion to s: α_c is then σ_c²/s², and the slope leaves out that s moves. The mean is
x̂ = W z/(μ + α).

`CorrelatedNoise` is shared by neighbouring pixels: smooth light that a scene lacks, or has too
much.

    n_c ~ N(0, σ_c² (I + Φ diag(d) Φᵀ))

Bounces, paint and shapes that are not as their file says change light smoothly, by less than 1 %,
but by more than the mean over many pixels errs. Taken for white noise, that light moves a scene
until its shadows explain it. The columns of Φ are orthonormal waves over the wall, beyond the
ambient light. Those of one octave share one d: their variance in a residual over white noise's.

`SharpImages` are nonnegative and have few edges. What they minimize,

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

from abc import ABC, abstractmethod
from dataclasses import dataclass, replace
from functools import cached_property, partial
from typing import Any, TypeVar

import numpy as np
from numpy.typing import NDArray
from scipy import linalg, sparse

from periscopy_sim.errors import PhotographError
from periscopy_sim.hidden import Differences, Hidden
from periscopy_sim.model.uncertainty import curvature_of_total_variation
from periscopy_sim.numerics import Array, Mask
from periscopy_sim.reconstruction.noise_aware import NoiseAware

Matrix = NDArray[np.floating[Any]]

FLAT = 0.1
"""Difference over the image's root mean square below which neighbours are no edge; its square is
the weight of how bright an image is, beside how rough."""

RATIOS = np.geomspace(1e-10, 1e2, 73)
"""Values of α that are tried, over the mean energy of a column."""

UNKNOWN_SCALE, RATIO_ROUNDS, TINY = 0.01, 8, 1e-300
"""Of multiples s: their precision times s², so that they are free in effect; how often they and α
are updated; the least s²."""

ROUNDING = 1e-7
"""Relative rounding of A, which is computed in single precision."""


@dataclass(frozen=True, eq=False)
class Explanation(ABC):
    """Photographs of C channels explained by a transport matrix, images and ambient light."""

    cost: float  # Σ E_c: a difference of 2 is a likelihood ratio of e; less is better
    noise: Array  # (C,) σ_c
    lights: Array  # (N, C) light of the patches
    residual: Array  # (M, C) y⊥ − A⊥ f̂
    energy: Array  # (C,) ‖y⊥‖²
    background: Array  # (M, r) orthonormal basis of range(B)

    @property
    def freedom(self) -> int:
        """F, the pixels less the dimensions of ambient light."""
        return int(len(self.residual) - self.background.shape[1])

    @property
    @abstractmethod
    def volume(self) -> Matrix:
        """(M, N) derivative by the entries of A of half of what is no misfit."""

    def motion(self, light: Matrix) -> Array:
        """Return how photographs change with more light on the wall, (..., M, C), over σ."""
        Q = self.background
        return np.asarray((light - Q @ (Q.T @ light)) / self.noise)

    def pull(self, motions: Array) -> Array:
        """Return the misfit's part, (P,), of the derivatives of half the evidence along P changes.

        dE/2 = Σ_c −r_cᵀ dA f̂_c / σ_c² + ⟨volume, dA⟩, the rest at its best; `motions`, (P, M, C),
        are those of dA f̂.
        """
        return np.asarray(-np.einsum("mc,pmc,c->p", self.residual, motions, 1 / self.noise))

    @abstractmethod
    def beyond_image(self, motion: Array) -> Array:
        """Return what no hidden image can follow of motions, (P, M, C).

        J̃ = J⊥ − A⊥ H⁻¹ A⊥ᵀ J⊥, H the curvature by the image. The information on two parameters is
        the product of one's J̃ and the other's `motion` (Kaufman, BIT 15, 1975).
        """


@dataclass(frozen=True, eq=False)
class SmoothExplanation(Explanation):
    """Photographs explained by smooth images."""

    coefficients: Array  # (J, C) x̂
    ratios: Array  # (C,) α_c
    _basis: Any
    _columns: Array  # (M, J) X⊥
    _modes: tuple[Array, Array]  # μ (J,), W (J, J)

    @cached_property
    def volume(self) -> Matrix:
        """(M, N) derivative of Σ_c Σ log(1 + μ/α_c) / 2 by the entries of A."""
        μ, W = self._modes
        weights = (1 / (μ[:, None] + self.ratios)).sum(axis=1)
        volume = self._columns.astype(np.float32) @ ((W * weights) @ W.T).astype(np.float32)
        return np.asarray((self._basis @ volume.T).T, np.float32)

    def beyond_image(self, motion: Array) -> Array:
        """Return what no hidden image can follow of motions, with H = X⊥ᵀX⊥ + α K."""
        return motion - (self._columns @ self.followed(motion)).transpose(2, 1, 0)

    @property
    def covariance(self) -> Array:
        """(J, J) of the first channel's x."""
        μ, W = self._modes
        return np.asarray(self.noise[0] ** 2 * (W / (μ + self.ratios[0])) @ W.T)

    def followed(self, motion: Array) -> Array:
        """Return by how much less light the image would have, (C, J, P), H⁻¹ X⊥ᵀ J."""
        (μ, W), moves = self._modes, self._columns.T @ motion.transpose(2, 1, 0)
        return np.asarray(W @ ((W.T @ moves) / (μ + self.ratios[:, None])[:, :, None]))


@dataclass(frozen=True, eq=False)
class SmoothImages:
    """What the monitor may have shown: f = S x, x ~ N(0, K⁻¹/α)."""

    basis: Any  # (N, J) S, sparse or dense
    precision: Array  # (J, J) K
    typical: Array | None = None  # (J,) m

    @classmethod
    def hats(cls, hidden: Hidden, coarse: Hidden) -> SmoothImages:
        """Return smooth sums of bilinear hat functions at the patches of hidden surfaces.

        `coarse` has the same surfaces in (r, c) patches, at whose middles the hats stand. As many
        hats as patches are the patches. Images of patches cannot follow a shift by half a patch, so
        the evidence has a minimum at each whole one. Wider hats can.
        """
        hats = []
        for surface, wide in zip(hidden.values(), coarse.values(), strict=True):
            down, across = map(_hats_along, surface.shape, wide.shape)
            hats.append(sparse.kron(down, across))
        return cls(sparse.block_diag(hats, format="csr"), smoothness(coarse))

    @classmethod
    def like(cls, hidden: Hidden, f: Array) -> SmoothImages:
        """Return images of patches with the edges of images f, (N, C)."""
        return cls(sparse.eye_array(len(f), format="csr"), smoothness(hidden, f))

    @classmethod
    def shown(cls, picture: Matrix, row: tuple[Array, Array] | None = None) -> SmoothImages:
        """Return a known picture, (N, P), in any mixture of its colours.

        `row` has mean and covariance of a channel's mixture over its sum, see `row_priors`. A
        black picture raises a PhotographError.
        """
        colours = np.asarray(picture, np.float64)
        gram = colours.T @ colours
        if not np.trace(gram) > 0:
            raise PhotographError("the shown picture is black: give one that lights the wall")
        if row is None:
            ridge = 10 * ROUNDING * np.trace(gram)  # colours that depend on each other, but rounded
            return cls(colours, gram + ridge * np.eye(len(gram)))
        mean, covariance = row
        sums = np.ones((len(mean), len(mean)))
        deviation = np.eye(len(mean)) - mean[:, None] * sums  # from the mean times the row's sum
        precision = deviation.T @ np.linalg.pinv(covariance, 1e-6, hermitian=True) @ deviation
        return cls(colours, precision + UNKNOWN_SCALE * sums, mean)

    def explain(self, A: Matrix, background: Array, y: Array) -> SmoothExplanation:
        """Explain photographs y, (M, C) of any unit, by a transport matrix A, (M, N).

        The background is an orthonormal basis of range(B), (M, r).
        """
        Q = background
        # In single precision weak patterns would explain more than there is.
        X = np.ascontiguousarray((self.basis.T @ A.T).T, np.float64)
        X -= Q @ (Q.T @ X)
        y_free = y - Q @ (Q.T @ y)
        gram = X.T @ X
        unit = np.trace(gram) / len(gram) or 1.0  # of darkness, which explains nothing
        μ, W = linalg.eigh(gram / unit, self.precision, check_finite=False)
        μ = np.maximum(μ, 0) * unit
        z = W.T @ (X.T @ y_free)
        freedom = len(y) - Q.shape[1]
        # A photograph without noise still has finite precision.
        energy = np.einsum("mc,mc->c", y_free, y_free)
        energy += freedom * ROUNDING**2 * float(np.mean(y**2))
        ratio = _best_ratio
        if self.typical is not None:
            ratio = partial(_relative_ratio, W.T @ (self.precision @ self.typical))
        columns = zip(z.T / np.sqrt(unit), energy, strict=True)
        best = [ratio(μ / unit, each, e, freedom) for each, e in columns]
        ratios = unit * np.array([α for α, _, _ in best])
        coefficients = W @ (z / (μ[:, None] + ratios))
        residual = y_free - X @ coefficients
        return SmoothExplanation(
            cost=sum(E for _, _, E in best),
            noise=np.sqrt(np.array([misfit for _, misfit, _ in best]) / freedom),
            lights=np.asarray(self.basis @ coefficients),
            residual=residual,
            energy=energy,
            background=Q,
            coefficients=coefficients,
            ratios=ratios,
            _basis=self.basis,
            _columns=X,
            _modes=(μ, W),
        )


def smoothness(hidden: Hidden, f: Array | None = None) -> Array:
    """Return K for images of the N patches of hidden surfaces, (N, N).

    xᵀ K x = Σ w (difference of neighbours)² + ε² ‖x‖², ε = `FLAT`, w = 1, or of images f, (N, C),
    in proportion to 1/√(‖difference‖² + ε² their mean square): xᵀ K x is then near the total
    variation (Vogel, Oman, SIAM J. Sci. Comput. 17, 1996). Beyond a surface all is dark: else an
    image moved until it touches the border would be smoother than one that does not, and the
    evidence would favour a place whole patches from the right one.
    """
    D = hidden.differences.in_the_dark
    weights = np.ones(D.shape[0])
    if f is not None:
        edges = np.sum((D @ f) ** 2, axis=1)
        weights = (edges + FLAT**2 * (np.mean(f**2) or 1.0)) ** -0.5
        weights /= weights.mean()
    K: Array = (D.T @ sparse.diags_array(weights) @ D).toarray()
    K[np.diag_indices_from(K)] += FLAT**2
    return K


def _hats_along(size: int, count: int) -> Any:
    """Return the heights, (size, count), of a row of hats at the middles of patches."""
    places = (np.arange(size) + 0.5) * count / size - 0.5
    return sparse.csr_array(np.maximum(1 - np.abs(places[:, None] - np.arange(count)), 0))


def _best_ratio(μ: Array, z: Array, energy: float, freedom: int) -> tuple[float, float, float]:
    """Return the α at which a channel's E_c is least, S_c and E_c there."""
    squares = z**2

    def misfit_and_cost(ratios: Array) -> tuple[Array, Array]:
        sums = (squares / (μ + ratios[:, None])).sum(axis=1)
        misfit = np.maximum(energy - sums, ROUNDING**2 * energy)
        return misfit, freedom * np.log(misfit) + np.log1p(μ / ratios[:, None]).sum(axis=1)

    _, cost = misfit_and_cost(RATIOS)
    least = int(np.clip(np.argmin(cost), 1, len(RATIOS) - 2))
    a, b, c = cost[least - 1 : least + 2]  # the parabola through neighbours in log α
    bend = a - 2 * b + c
    move = np.clip((a - c) / (2 * bend), -1, 1) if bend > 0 else np.sign(a - c)
    α = RATIOS[least] * (RATIOS[1] / RATIOS[0]) ** move
    misfit, refined = misfit_and_cost(np.array([α]))
    return float(α), float(misfit[0]), float(refined[0])


def _relative_ratio(
    direction: Array, μ: Array, z: Array, energy: float, freedom: int
) -> tuple[float, float, float]:
    """Return α_c = σ_c²/s², s the multiple of a direction Wᵀ K m, and S_c and E_c there.

    The multiple s hardly depends on A, so the slope leaves its change out.
    """
    scale = float(z @ direction) / max(float(μ @ direction**2), TINY)
    misfit = max(energy - scale * float(z @ direction), ROUNDING**2 * energy)
    for _ in range(RATIO_ROUNDS):
        α = float(np.clip(misfit / freedom / max(scale**2, TINY), RATIOS[0], RATIOS[-1]))
        modes = z / (μ + α)
        misfit = max(energy - float(z @ modes), ROUNDING**2 * energy)
        scale = float(direction @ modes / np.sum(direction**2))
    return α, misfit, freedom * float(np.log(misfit)) + float(np.log1p(μ / α).sum())


Real = TypeVar("Real", bound=NDArray[np.floating[Any]])

HALF_WAVES, LONG = 16, 8
"""Waves have fewer half waves across the wall, since scenes hardly explain rougher light; those of
fewer than the second share one variance, since ambient light has most of them. Both are chosen."""

NEW, PART = 0.1, 3
"""Least norm that a wave keeps beyond the ambient light and longer waves; and of how many numbers
one is a wave's at most, so that the others show white noise."""


@dataclass(frozen=True, eq=False)
class CorrelatedNoise:
    """Noise in M pixels of a wall, that varies more along F waves; see the module."""

    waves: NDArray[np.float32]  # (M, F) Φ
    octaves: NDArray[np.intp]  # (F,) of each wave
    excess: Array  # (F,) d
    freedom: int  # dimensions beyond the waves and the ambient light

    @classmethod
    def white(
        cls, pixels: Mask, background: Array, half_waves: int = HALF_WAVES
    ) -> CorrelatedNoise:
        """Return white noise in M pixels, beyond an orthonormal basis of ambient light, (M, r)."""
        lines = [
            np.cos(np.pi * np.outer(np.arange(min(n, half_waves + 1)), (np.arange(n) + 0.5) / n))
            for n in pixels.shape
        ]
        down, across = np.indices([len(each) for each in lines]).reshape(2, -1)
        number = np.hypot(down, across)
        order = np.argsort(number, kind="stable")
        dimensions = len(background) - background.shape[1]
        order = order[(number[order] > 0) & (number[order] < half_waves)]
        order = order[: dimensions // PART]
        waves = np.einsum("fr,fc->rcf", lines[0][down[order]], lines[1][across[order]])[pixels]
        waves /= np.linalg.norm(waves, axis=0)
        waves -= background @ (background.T @ waves)
        waves, triangle = np.linalg.qr(waves)
        is_new = np.abs(np.diag(triangle)) > NEW
        octaves = np.log2(np.maximum(number[order][is_new], LONG / 2)).astype(int)
        waves, count = waves[:, is_new].astype(np.float32), len(octaves)
        return cls(waves, octaves, np.zeros(count), dimensions - count)

    def whitened(self, light: Real) -> Real:
        """Return light, (M, ...), times the root of the inverse covariance over σ²."""
        if not self.excess.any():
            return light
        flat = light.reshape(len(light), -1)
        less = (1 - 1 / np.sqrt(1 + self.excess)).astype(np.float32)
        shared = self.waves @ (less[:, None] * (self.waves.T @ flat))
        return (flat - shared).reshape(light.shape).astype(light.dtype)  # type: ignore[return-value]

    def like(self, residuals: Array) -> CorrelatedNoise:
        """Return noise that varies as residuals do beyond the ambient light, (M, C).

        An octave's variance is the mean over its waves and the channels, each relative to the
        variance beyond all waves.
        """
        amplitudes = self.waves.T @ residuals
        rest = np.sum(residuals**2, axis=0) - np.sum(amplitudes**2, axis=0)
        white = np.maximum(rest / self.freedom, TINY)  # a dark channel has none
        power = np.mean(amplitudes**2 / white, axis=1)
        counts = np.bincount(self.octaves)
        variances = np.bincount(self.octaves, power) / np.maximum(counts, 1)
        return replace(self, excess=np.maximum(variances - 1, 0)[self.octaves])


SHARP_ROUNDS, TOLERANCE = 4, 1e-4
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
            for _ in range(SHARP_ROUNDS):
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
