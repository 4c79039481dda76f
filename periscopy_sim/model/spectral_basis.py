"""The linear equations behind the noise-aware method, solved in the spectral basis of a scene.

The patterns W_k are the generalized eigenvectors of A⊥ᵀA⊥ and K = ∇ᵀ∇ + I, their curvatures λ_k the
eigenvalues. Found once, they solve (w A⊥ᵀA⊥ + ρ K) f = d + ρ g for any weight w of a channel, any ρ
and any right-hand side, with d_k = ⟨W_k, d⟩ and g_k = ⟨W_k, g⟩:

    f = Σ_k W_k (d_k + ρ g_k) / (w λ_k + ρ) = K⁻¹ g + Σ_k W_k (d_k − w λ_k g_k) / (w λ_k + ρ).

λ_k falls by many powers of ten, so a photograph's noise hides all but some hundred patterns, hardly
more of them on finer grids (λ_k > 0.01 ρ at SBR 0.5 and 60 dB: 623, 754 and 1,127 of 1,044, 1,620
and 6,480 patches). For many patches, only the strongest patterns are computed. With d' the data
beyond them, for which λ_k counts as 0, the second form has the term K⁻¹ d'/ρ more.
"""

from collections.abc import Callable
from dataclasses import dataclass
from functools import cached_property, partial
from typing import Any, Self

import numpy as np
from scipy import fft, linalg, sparse

from periscopy_sim.hidden import Differences, Hidden
from periscopy_sim.model.transport_operator import TransportOperator
from periscopy_sim.numerics import Array, Image
from periscopy_sim.numerics.products import filter_rows, project_out

MOST_PATTERNS = 1200
"""Patterns that a basis has at most. With so many of 6,480 an image (SBR 0.5, 60 dB) differs from
that of all patterns by 0.1 standard errors at most (`experiments.benchmarks`, fine-grids)."""

RATE = 1e11
"""Multiplications and additions a second, in single precision, of two cores."""

ROUNDS = 2
"""Products with A⊥ᵀA⊥ that the random start of the strongest patterns takes."""

FAINTEST = 1e-10
"""Curvature over the largest, below which a pattern's light in single precision is rounding."""

RIDGE = 1e-12
"""Added to the products of unit images, which may be dependent but for rounding."""


@dataclass(frozen=True, eq=False)
class SpectralBasis:
    """The generalized eigenvectors of one scene, its patterns: all, or the strongest of them."""

    curvatures: Array  # (K,) λ, ascending
    rows: Image  # (K, N) W_k in row k, in single precision
    hidden: Hidden  # the surfaces of the N patches
    exact: Array | None = None  # (K, N) the rows in double precision, of all patterns

    @classmethod
    def of_gram(cls, gram: Array, hidden: Hidden) -> Self:
        """Return all patterns of A⊥ᵀA⊥, (N, N)."""
        curvatures, W = linalg.eigh(gram, laplacian(hidden.differences).toarray())
        exact = np.ascontiguousarray(W.T)
        return cls(np.maximum(curvatures, 0), exact.astype(np.float32), hidden, exact)

    @classmethod
    def strongest(cls, A: TransportOperator, hidden: Hidden, count: int, seed: int = 0) -> Self:
        """Return the strongest patterns of A⊥ over its unit, ‖A⊥‖_F/√N, from random photographs.

        Halko, Martinsson, Tropp, "Finding structure with randomness", 2011, Sec. 4.5, in K's inner
        product. It takes 2 `ROUNDS` products of A with `count` vectors.
        """
        K, inverse = laplacian(hidden.differences), InverseLaplacian(hidden)
        unit = np.float32(np.sqrt(A.squared_norm / hidden.patches))
        random = np.random.default_rng(seed)
        light = random.standard_normal((count, A.shape[0]), dtype=np.float32)
        light = project_out(light, np.ascontiguousarray(A.Q.T, np.float32))
        for _ in range(ROUNDS):
            images = inverse(A.images_of(light) / unit)
            for _ in range(2):  # single precision needs a second pass
                images = _orthonormal(images, K)
            light = A.light_of(images) / unit
            exact = light.astype(np.float64)  # rounded products would show no weak pattern
            curvatures, V = np.linalg.eigh(exact @ exact.T)
            kept = curvatures > FAINTEST * curvatures[-1]
            curvatures, V = curvatures[kept], V[:, kept]
            light = (V / np.sqrt(curvatures)).T.astype(np.float32) @ light
        return cls(curvatures, V.T.astype(np.float32) @ images, hidden)

    @property
    def is_whole(self) -> bool:
        """Whether there is a pattern for each patch."""
        return len(self.rows) == self.hidden.patches

    @cached_property
    def inverse_laplacian(self) -> "InverseLaplacian":
        """K⁻¹."""
        return InverseLaplacian(self.hidden)

    def lights(self, A: TransportOperator, unit: float, visible: slice) -> Image:
        """Return the light of visible patterns over its norm, A⊥ W_k/(unit √λ_k), orthonormal rows.

        The light of a weak pattern is a millionth of a strong one's. Rounded to single precision,
        the pattern has 1e-3 of its light from strong ones, more than a photograph's noise: in
        double precision, each loses what it has of stronger ones. The rows are (K', M), rounded.
        """
        scales = 1 / (np.sqrt(self.curvatures[visible]) * unit)
        exact = A.light_of(self.rows[visible] * scales[:, None])
        change = _inverse_factor((exact @ exact.T)[::-1, ::-1])[::-1, ::-1] - np.eye(len(exact))
        light = exact.astype(np.float32)
        del exact  # before a product as large
        light += np.ascontiguousarray(change, np.float32) @ light  # small: single suffices
        return light

    def combined(self, coefficients: Array) -> Image:
        """Return the sum of patterns by (3, K) coefficients, (3, N)."""
        nothing = np.zeros((len(coefficients), self.rows.shape[1]), np.float32)
        zeros = np.zeros(coefficients.shape, np.float32)
        return filter_rows(nothing, self.rows, zeros, coefficients.astype(np.float32))


def cost(pixels: int, patches: int) -> tuple[float, float]:
    """Return about the bytes and seconds that the patterns of A, (M, N), take, with their light.

    Bytes beside A are those of the standard errors, in double precision, and of the products with
    A, in single.
    """
    count = min(patches, MOST_PATTERNS)
    memory = count * (12.0 * pixels + 48.0 * patches)
    products = 2 * ROUNDS + 2  # with the light, which is computed anew, in double precision
    return memory, 2.0 * products * count * pixels * patches / RATE


def _orthonormal(images: Image, K: Any) -> Image:
    """Return a basis of images, (k, N), that is orthonormal in K's inner product."""
    exact = images.astype(np.float64)  # their products, whose rounding would be indefinite
    smoothed = K @ exact.T
    norms = np.sqrt(np.einsum("kn,nk->k", exact, smoothed))
    products = exact @ smoothed / np.outer(norms, norms)
    products[np.diag_indices_from(products)] += RIDGE
    return np.asarray((_inverse_factor(products) / norms).astype(np.float32) @ images)


def _inverse_factor(products: Image) -> Array:
    """Return the inverse of the lower Cholesky factor of products, (k, k)."""
    inverse, _ = linalg.lapack.dtrtri(linalg.cholesky(products, lower=True), lower=True)
    return np.asarray(inverse)


class Solver:
    """The equations of three channels of one photograph, for any g.

    The weights w are (3, 1), or (3, K) of each pattern, ρ is positive and the data d_k are (3, K).
    Patterns of w λ_k below the part `weak` of ρ are summed only when asked to.
    Where w λ_k ≪ ρ, as for most patterns, their sum in the second form of f hardly depends on g:
    that of an earlier g nearby then serves as well. Without such patterns, and with all of the
    others, the first form is taken, in which no digits cancel. The rest, (3, N), is d' of the
    module; None of all patterns.
    """

    def __init__(
        self,
        patterns: SpectralBasis,
        weights: Array,
        ρ: float,
        data: Array,
        weak: float,
        rest: Array | None = None,
    ) -> None:
        curvature = weights * patterns.curvatures
        edge = int(np.searchsorted(curvature.max(axis=0), weak * ρ))
        second = edge > 0 or not patterns.is_whole
        gain = (-curvature if second else ρ) / (curvature + ρ)
        offset = data / (curvature + ρ)

        def summed(part: slice) -> Callable[[Image], Image]:
            return partial(
                filter_rows,
                rows=patterns.rows[part],
                gain=np.ascontiguousarray(gain[:, part], np.float32),
                offset=np.ascontiguousarray(offset[:, part], np.float32),
            )

        self._weak, self._strong = summed(slice(edge)), summed(slice(edge, None))
        self._inverse = patterns.inverse_laplacian if second else None
        self._rest: Any = 0.0
        if rest is not None:
            self._rest = patterns.inverse_laplacian(np.asarray(rest / ρ, np.float32))
        self._kept: Image | None = None

    def __call__(self, g: Image, renew: bool = True) -> Image:
        """Return f of (3, N) g in single precision; weak patterns are summed anew if `renew`."""
        f = self._strong(g)
        if self._inverse is not None:
            if renew or self._kept is None:
                self._kept = self._weak(g) + self._rest
            f += self._kept
            f += self._inverse(g)
        return f


class InverseLaplacian:
    """K⁻¹ of hidden surfaces, which K does not join: of each by cosine transforms."""

    def __init__(self, hidden: Hidden) -> None:
        self._hidden, self._gains = hidden, []
        for shape in hidden.shapes.values():
            λ, μ = (2 - 2 * np.cos(np.pi * np.arange(size) / size) for size in shape)
            self._gains.append((1 / (1 + λ[:, None] + μ)).astype(np.float32))

    def __call__(self, vectors: Image) -> Image:
        """Return K⁻¹ of each of (K, N) images in single precision."""
        parts = []
        for gain, part in zip(self._gains, self._hidden.slices.values(), strict=True):
            images = vectors[:, part].reshape(-1, *gain.shape)
            # Not by products with matrices: the threads of BLAS would take the cores.
            spectra = fft.dctn(images, axes=(1, 2), norm="ortho") * gain
            inverse = fft.idctn(spectra, axes=(1, 2), norm="ortho")
            parts.append(inverse.reshape(len(vectors), -1))
        return np.hstack(parts) if len(parts) > 1 else parts[0]


def laplacian(differences: Differences) -> Any:
    """Return K = ∇ᵀ∇ + I for images of N patches, sparse (N, N)."""
    D = differences.matrix
    return (D.T @ D + sparse.eye_array(D.shape[1])).tocsc()
