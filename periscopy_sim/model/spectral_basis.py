"""The linear equations behind the noise-aware method, solved in the spectral basis of a scene.

The patterns W_k are the generalized eigenvectors of A⊥ᵀA⊥ and K = ∇ᵀ∇ + I, their curvatures λ_k the
eigenvalues. Found once, they solve (w A⊥ᵀA⊥ + ρ K) f = d + ρ g for any weight w of a channel, any ρ
and any right-hand side, with d_k = ⟨W_k, d⟩ and g_k = ⟨W_k, g⟩:

    f = Σ_k W_k (d_k + ρ g_k) / (w λ_k + ρ) = K⁻¹ g + Σ_k W_k (d_k − w λ_k g_k) / (w λ_k + ρ).
"""

from collections.abc import Callable
from functools import partial
from typing import Any, TypeAlias

import numpy as np
from scipy import linalg, sparse

from periscopy_sim.hidden import Differences, Hidden, Size
from periscopy_sim.numerics import Array, Image
from periscopy_sim.numerics.products import filter_rows

Inverse: TypeAlias = Callable[[Image], Image]


class SpectralBasis:
    """The generalized eigenvectors of one scene, its patterns.

    They follow from A⊥ᵀA⊥, (N, N), for images on hidden surfaces of N patches.
    """

    def __init__(self, gram: Array, hidden: Hidden) -> None:
        curvatures, W = linalg.eigh(gram, laplacian(hidden.differences).toarray())
        self.curvatures: Array = np.maximum(curvatures, 0)  # (N,) λ, ascending
        self.rows = np.ascontiguousarray(W.T, np.float32)  # (N, N), W_k in row k
        self.inverse_laplacian = InverseLaplacian(hidden)

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
    """K⁻¹ of hidden surfaces, which K does not join.

    Where a surface's columns are alike, and its rows, as on planes and cylinders, the eigenvectors
    down and across give it in a small part of the time that a dense inverse takes.
    """

    def __init__(self, hidden: Hidden) -> None:
        self._hidden = hidden
        self._inverses = [
            inverse_by_axes(differences, surface.shape) or dense_inverse(differences)
            for surface, differences in zip(
                hidden.values(), hidden.differences_by_surface.values(), strict=True
            )
        ]

    def __call__(self, vectors: Image) -> Image:
        """Return K⁻¹ of each of (K, N) images in single precision."""
        if len(self._inverses) == 1:
            return self._inverses[0](vectors)
        parts = zip(self._inverses, self._hidden.slices.values(), strict=True)
        return np.hstack([inverse(vectors[:, part]) for inverse, part in parts])

    def __reduce__(self) -> tuple[Any, ...]:
        """Leave the inverses, which are functions, to be computed anew."""
        return InverseLaplacian, (self._hidden,)


def inverse_by_axes(differences: Differences, shape: Size) -> Inverse | None:
    """Return K⁻¹ of a surface, (R, C), by the eigenvectors of K down and across.

    None if the weights of differences down vary across, or those of differences across vary down.
    """
    down, across = differences.weights.reshape(2, *shape)
    if np.any(down != down[:, :1]) or np.any(across != across[:1]):
        return None
    patches = np.arange(down.size).reshape(shape)
    D, lines = differences.matrix, (patches[:, 0], patches[0])  # the first column and row
    along = (D[line + k * down.size][:, line].toarray() for k, line in enumerate(lines))
    (λ, U), (μ, V) = (linalg.eigh(each.T @ each) for each in along)
    gain = (1 / (1 + λ[:, None] + μ)).astype(np.float32)
    U, V = (np.ascontiguousarray(each, np.float32) for each in (U, V))

    def inverse(vectors: Image) -> Image:
        images = vectors.reshape(-1, *shape)
        return np.reshape(U @ ((U.T @ images @ V) * gain) @ V.T, vectors.shape)

    return inverse


def dense_inverse(differences: Differences) -> Inverse:
    """Return K⁻¹ of any surface."""
    inverse = linalg.inv(laplacian(differences).toarray()).astype(np.float32)
    return lambda vectors: vectors @ inverse


def laplacian(differences: Differences) -> Any:
    """Return K = ∇ᵀ∇ + I for images of N patches, sparse (N, N)."""
    D = differences.matrix
    return (D.T @ D + sparse.eye_array(D.shape[1])).tocsc()
