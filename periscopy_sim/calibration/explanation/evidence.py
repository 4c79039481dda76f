"""How well a transport matrix explains a photograph, whatever the hidden image and ambient light.

    y_c = A f_c + B b_c + n_c,   f_c ~ N(0, σ_c²/α_c K⁻¹),   n_c ~ N(0, σ_c² I),   b_c free

K says that hidden images are smooth rather than not, see `image_prior`. All but A is eliminated
(variable projection: Golub and Pereyra, SIAM J. Numer. Anal. 10, 1973), the image not at its best
fit but by integration (the evidence: MacKay, Neural Comput. 4, 1992): a best fit alone would favour
the A that bends to any photograph. What is left is one number for a channel,

    E_c = F log S_c + Σ log(1 + μ/α_c),   S_c = ‖y⊥‖² − Σ z_c²/(μ + α_c) = F σ_c²,

twice the negative logarithm of the evidence but for a constant; F is M less the rank of B, μ and W
are the generalized eigenvalues and vectors of (A⊥ᵀA⊥, K), z = Wᵀ A⊥ᵀ y⊥, ⊥ stands for range(B)
projected out. Each α_c is where E_c is least.

That is so where errors n are white. Errors that neighbours share, of paint, bounced light or a
misplaced scene, are strong at some scales. There y, A and B are divided by how strong, see
`discrepancy`, which makes what is left white. If its slopes still vary κ times as much as those of
white errors (`Curvature.overdispersion`), the evidence counts for 1/κ of that, beside the prior of
the parameters (a composite likelihood adjusted in magnitude: Ribatet, Cooley and Davison,
Statistica Sinica 22, 2012).

Images of any sign are integrated over, and f̂ = W z/(μ + α) is their mean. To keep the best fit from
shining negatively while integrating over all would be no marginal likelihood: where a border of
the image is dark, volume and misfit no longer balance, and the right scene has a slope (a monitor's
exponent ended 3 told errors off). Masks are told by it all the same, see `mask_evidence`.
"""

from __future__ import annotations

from dataclasses import dataclass, field, replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from periscopy_sim.calibration.explanation.image_fit import Filter, ImageFit, fit_image
from periscopy_sim.calibration.explanation.smooth_gain import SmoothGain
from periscopy_sim.model.wall_gain import SPREAD

Array = NDArray[np.float64]

LEAST_VARIANCE = 1e-6
"""Part of the residuals' energy that a gain leaves at least."""


@dataclass(frozen=True, eq=False)
class Explanation:
    """A photograph explained by a transport matrix.

    The evidence is Σ E_c: a difference of 2 is a likelihood ratio of e. `darkness` is what it would
    be of a black hidden image: where the evidence is less, the photograph shows one. A `gain` over
    the wall, see `SmoothGain`, multiplies A.
    """

    fit: ImageFit  # of hidden image and light, with the gain as it was before
    evidence: float
    darkness: float
    noise: Array  # (3,) σ_c, of what is left unexplained
    overdispersion: float  # κ, by which each error counts for less
    residuals: Array  # (M, 3) y⊥ − A⊥ f̂
    gain: SmoothGain | None = None
    # How the photograph moves with the gain, beyond images, over σ κ^½, and the gain's covariance.
    gain_terms: Array = field(default_factory=lambda: np.zeros((0, 0, 3)))  # (K, M, 3)
    gain_covariance: Array = field(default_factory=lambda: np.zeros((0, 0)))  # (K, K)

    @classmethod
    def of(cls, fit: ImageFit, overdispersion: float = 1.0) -> Explanation:
        """Return what an image's fit explains, where errors vary κ times as much as white ones."""
        κ = overdispersion
        return cls(fit, fit.evidence / κ, fit.darkness / κ, fit.noise, κ, fit.residuals)

    @property
    def images(self) -> Array:
        """(N, 3) the most probable hidden image, f̂."""
        return self.fit.images

    @property
    def deviations(self) -> Array:
        """(3,) σ_c κ^½: of white noise that tells as much as the errors do."""
        return np.asarray(self.noise * np.sqrt(self.overdispersion))

    @property
    def left(self) -> float:
        """Part of y⊥, root mean square, that is left unexplained."""
        photograph = self.fit.residuals + self.fit.light  # without a gain's part
        return float(np.linalg.norm(self.residuals) / np.linalg.norm(photograph))

    @property
    def darker_than_black(self) -> float:
        """Part of the hidden image's light, in absolute value, that is negative."""
        images = self.images
        return float(np.maximum(-images, 0).sum() / (np.abs(images).sum() or 1.0))

    def _gained(self, light: NDArray[np.floating[Any]]) -> Any:
        """Return light, (M, ...), as the gain makes it."""
        if self.gain is None:
            return light
        return self.gain.field.astype(light.dtype)[:, None] * light

    def slope(self, change: NDArray[np.floating[Any]], moved: Array | None = None) -> float:
        """Return the derivative of the evidence along a change dA of the matrix, (M, N).

        dE = Σ_c (−2 r_cᵀ dA f̂_c / σ_c² + 2 ⟨A⊥ (A⊥ᵀA⊥ + α_c K)⁻¹, dA⟩) / κ, the α_c held; r and A⊥
        have no part in range(B), so dA's own does not matter. If it is known, `moved` is the
        `jacobian` along dA.
        """
        moved = self.jacobian(change) if moved is None else moved
        misfit = np.einsum("mc,mc,c->", self.residuals, moved, 1 / self.deviations)
        by_pixel = np.einsum("mn,mn->m", self.fit.volume, change)
        volume = by_pixel.sum() if self.gain is None else self.gain.field @ by_pixel
        return float(2 * (volume / self.overdispersion - misfit))

    @property
    def gradient(self) -> Array:
        """(M, N) the derivatives of the evidence by each entry of the matrix, see `slope`."""
        errors = self._gained(self.fit.whitened(self.residuals / self.deviations**2))
        misfit = errors @ self.images.T
        return np.asarray(2 * (self._gained(self.fit.volume) / self.overdispersion - misfit))

    def jacobian(self, change: NDArray[np.floating[Any]]) -> Array:
        """Return how the photograph moves along dA, J = dA f̂: J⊥ / (σ κ^½), (M, 3)."""
        return self.moved(self.lit(change))

    def lit(self, change: NDArray[np.floating[Any]]) -> NDArray[np.floating[Any]]:
        """Return the light on the wall, (M, 3), of the hidden image by a matrix, (M, N)."""
        return change @ self.images.astype(change.dtype)

    def moved(self, light: NDArray[np.floating[Any]]) -> Array:
        """Return how the photograph moves with more light on the wall, (..., M, 3): over σ κ^½."""
        whitened = self.fit.whitened(self._gained(light))
        return np.asarray(self.fit.without_background(whitened) / self.deviations)

    def projected(self, moved: Array) -> Array:
        """Return of `jacobian`s, (..., M, 3), what image, light and gain could not follow.

        J̃ = J⊥ − A⊥ H⁻¹ A⊥ᵀ J⊥ over σ κ^½, H = A⊥ᵀA⊥ + αK, and of that what no gain could follow.
        The information on two parameters is the product of one's J̃ and the other's `jacobian`.
        """
        beyond = self.fit.beyond_image(moved)
        if not len(self.gain_terms):
            return beyond
        pull = np.tensordot(moved, self.gain_terms, ([-2, -1], [-2, -1]))
        by_gain = np.tensordot(pull @ self.gain_covariance, self.gain_terms, 1)
        return np.asarray(beyond - by_gain)

    def left_of(self, errors: Array) -> Array:
        """Return what image, light and gain would leave of small errors, (..., M, 3) over σ κ^½."""
        return self.projected(self.fit.without_background(errors))

    def shown(self, images: Array) -> Array:
        """Return how the photograph moves, (M, 3), as the hidden image does by (N, 3).

        It is over σ κ^½, the unit of `jacobian`.
        """
        return np.asarray(self.fit.shown(images) / self.deviations)

    def unabsorbed(self, pixels: NDArray[np.intp]) -> Array:
        """Return residuals over σ κ^½ at some pixels, (m, 3), raised by what was absorbed."""
        return self.fit.unabsorbed(pixels, self.residuals[pixels] / self.deviations)

    def leverage(self, A: NDArray[np.floating[Any]]) -> Array:
        """Return how the image's volume grows with the gain at each pixel, (M,), see `SmoothGain`.

        A, (M, N), is the matrix that explains the photograph, without the gain.
        """
        return np.asarray(np.einsum("mn,mn->m", self.fit.volume, A))

    def with_gain(
        self, near: SmoothGain, A: NDArray[np.floating[Any]], leverage: Array | None = None
    ) -> Explanation:
        """Return what explains the photograph with the best gain near one, see `SmoothGain`.

        This one must explain it by `near.field` times A, (M, N). The images stay f̂, as derivatives
        do: where the gain has moved far, explain it again by that gain. A `leverage`, (M,), is
        taken that is known of a matrix much like it.
        """
        if not (self.noise > 0).all():
            return self
        leverage = self.leverage(A) if leverage is None else leverage
        light = self.fit.whitened(near.terms[:, :, None] * (A @ self.images))
        terms = self.fit.without_background(light) / self.deviations
        beyond = self.fit.beyond_image(terms)
        residuals = self.residuals / self.deviations
        by_channel = np.einsum("jmc,kmc->cjk", beyond, terms, optimize=True)
        pull = np.einsum("kmc,mc->ck", terms, residuals)
        precision = np.eye(len(terms)) / SPREAD**2
        H = by_channel.sum(axis=0) + precision
        # A gain that dims what is known well would else pass for a simpler scene.
        volume = near.terms @ leverage / self.overdispersion
        q = pull.sum(axis=0) - volume - precision @ near.coefficients
        best = near.moved(np.linalg.solve(H, q))
        change = best.coefficients - near.coefficients
        # Both over σ_c² κ: what a channel's least squares are less by.
        gained = 2 * pull @ change - np.einsum("cjk,j,k->c", by_channel, change, change)
        left = np.maximum(1 - gained * self.overdispersion / self.fit.freedom, LEAST_VARIANCE)
        followed = np.einsum("k,kmc->mc", change, beyond, optimize=True) * self.deviations
        return replace(
            self,
            evidence=self.evidence
            + float(self.fit.freedom * np.log(left).sum()) / self.overdispersion
            + 2 * float(volume @ change)
            + best.penalty,
            noise=self.noise * np.sqrt(left),
            residuals=self.residuals - followed,
            gain=best,
            gain_terms=beyond / np.sqrt(left),
            gain_covariance=np.linalg.inv(
                (by_channel / left[:, None, None]).sum(axis=0) + precision
            ),
        )


def explain(
    A: NDArray[np.floating[Any]],
    background: Array,
    y: Array,
    hidden_shape: tuple[int, int],
    overdispersion: float = 1.0,
    whitening: Filter | None = None,
) -> Explanation:
    """Explain a photograph y, (M, 3) of any unit, by a transport matrix A, (M, N), with N = R C.

    The overdispersion κ is 1 of white errors; all else as in `fit_image`.
    """
    return Explanation.of(fit_image(A, background, y, hidden_shape, whitening), overdispersion)
