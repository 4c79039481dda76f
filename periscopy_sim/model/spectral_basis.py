"""The linear equations behind the noise-aware method, solved in the spectral basis of a scene.

The patterns W_k are the generalized eigenvectors of A⊥ᵀA⊥ and K = ∇ᵀ∇ + I, their curvatures λ_k the
eigenvalues. Found once, they solve (w A⊥ᵀA⊥ + ρ K) f = d + ρ g for any weight w of a channel, any ρ
and any right-hand side, with d_k = ⟨W_k, d⟩ and g_k = ⟨W_k, g⟩:

    f = Σ_k W_k (d_k + ρ g_k) / (w λ_k + ρ) = K⁻¹ g + Σ_k W_k (d_k − w λ_k g_k) / (w λ_k + ρ).
"""

from collections.abc import Callable
from functools import partial

import numpy as np
from scipy import linalg

from periscopy_sim.numerics import Array, Image
from periscopy_sim.numerics.products import filter_rows


class SpectralBasis:
    """The generalized eigenvectors of one scene, its patterns.

    They follow from A⊥ᵀA⊥, (N, N), for images of (R, C) patches.
    """

    def __init__(self, gram: Array, shape: tuple[int, int]) -> None:
        curvatures, W = linalg.eigh(gram, laplacian(shape))
        self.curvatures: Array = np.maximum(curvatures, 0)  # (N,) λ, ascending
        self.rows = np.ascontiguousarray(W.T, np.float32)  # (N, N), W_k in row k
        self.inverse_laplacian = InverseLaplacian(shape)

    def combined(self, coefficients: Array) -> Image:
        """Return the sum of patterns by (3, N) coefficients, (3, N)."""
        nothing = np.zeros(coefficients.shape, np.float32)
        return filter_rows(nothing, self.rows, nothing, coefficients.astype(np.float32))


class Solver:
    """The equations of three channels of one photograph, for any g.

    The weights w are (3, 1), or (3, N) of each pattern, ρ is positive and the data d_k are (3, N).
    Patterns of w λ_k below the part `weak` of ρ are summed only when asked to.
    Where w λ_k ≪ ρ, as for most patterns, their sum in the second form of f hardly depends on g:
    that of an earlier g nearby then serves as well. Without such patterns the first form is taken,
    in which no digits cancel.
    """

    def __init__(
        self, patterns: SpectralBasis, weights: Array, ρ: float, data: Array, weak: float
    ) -> None:
        curvature = weights * patterns.curvatures
        edge = int(np.searchsorted(curvature.max(axis=0), weak * ρ))
        gain = (-curvature if edge else ρ) / (curvature + ρ)
        offset = data / (curvature + ρ)

        def summed(part: slice) -> Callable[[Image], Image]:
            return partial(
                filter_rows,
                rows=patterns.rows[part],
                gain=np.ascontiguousarray(gain[:, part], np.float32),
                offset=np.ascontiguousarray(offset[:, part], np.float32),
            )

        self._weak, self._strong = summed(slice(edge)), summed(slice(edge, None))
        self._inverse = patterns.inverse_laplacian if edge else None
        self._kept: Image | None = None

    def __call__(self, g: Image, renew: bool = True) -> Image:
        """Return f of (3, N) g in single precision; weak patterns are summed anew if `renew`."""
        f = self._strong(g)
        if self._inverse is not None:
            if renew or self._kept is None:
                self._kept = self._weak(g)
            f += self._kept
            f += self._inverse(g)
        return f


class InverseLaplacian:
    """K⁻¹ for images of (R, C) patches, by the eigenvectors of K down and across."""

    def __init__(self, shape: tuple[int, int]) -> None:
        (down, U), (across, V) = (linalg.eigh(second_differences(size)) for size in shape)
        self._gain = (1 / (1 + down[:, None] + across)).astype(np.float32)
        self._U, self._V = (np.ascontiguousarray(each, np.float32) for each in (U, V))

    def __call__(self, vectors: Image) -> Image:
        """Return K⁻¹ of each of (K, R C) images in single precision."""
        images = vectors.reshape(-1, *self._gain.shape)
        inverse = self._U @ ((self._U.T @ images @ self._V) * self._gain) @ self._V.T
        return np.reshape(inverse, vectors.shape)


def laplacian(shape: tuple[int, int]) -> Array:
    """Return K = ∇ᵀ∇ + I for images of (R, C) patches, (N, N), of forward differences."""
    down, across = (second_differences(size) for size in shape)
    K: Array = np.kron(down, np.eye(shape[1])) + np.kron(np.eye(shape[0]), across)
    K[np.diag_indices_from(K)] += 1
    return K


def second_differences(size: int) -> Array:
    """Return ∇ᵀ∇ for a row of patches, (size, size)."""
    differences = np.diff(np.eye(size), axis=0)
    return differences.T @ differences
