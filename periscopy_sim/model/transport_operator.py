"""The light transport matrix as an operator: passes over its rows, backgrounds projected out.

    A⊥ = A − Q QᵀA,   Q an orthonormal basis of range(B)

Q spans what the model leaves free beside the hidden image: B, photographs of ambient light, and
smooth profiles over the wall.
"""

from collections.abc import Iterator
from functools import cached_property

import numpy as np
from numpy.polynomial import legendre
from numpy.typing import DTypeLike
from scipy import linalg
from scipy.sparse.linalg import LinearOperator

from periscopy_sim.numerics import Array, Image, cast_columns, precision_of, products
from periscopy_sim.numerics.validation import InputError, checked_matrix

RANK_TOLERANCE = 1e-10
"""Relative tolerance on the singular values of B that are kept, or B's precision if that is more;
see `background_basis`."""

ROUNDING = 1e-12
"""Fraction of a vector, of the largest eigenvalue, or of an energy that counts as rounding."""

SKETCH = 96
"""Random mixtures of B's columns in the sketch: twice B's usual rank of 44."""

SKETCHED = 0.02
"""Last singular value within the sketch over the tolerance, at most. B in single precision, whose
roundings do not decay, leaves 5 times that value outside (512 columns; as the root of more)."""

PROFILE_DEGREE = 20
"""Degree of `wall_profiles`. On the real chair photograph degree 20 costs 0.02 to 0.08 dB, degree
12 costs 0.36, and one free number for each row and column 0.14; beside a window (rendered, SBR 0.2)
all of them gain 4.6 to 6 dB, the most at degree 20."""

PIXELS_A_DEGREE = 6
"""Pixels along a side for each degree of `wall_profiles`, at least: 126 pixels carry degree 20."""


def background_basis(B: Image, rank_tolerance: float = RANK_TOLERANCE) -> Array:
    """Return an orthonormal basis Q, (M, r) float64, of the numerical range of B, (M, L).

    B is rank-deficient to working precision: its lights are far away, so their responses are nearly
    the same few smooth fields. The basis has the left singular vectors of B, its columns scaled to
    unit norm, whose singular values exceed `rank_tolerance`, in (0, 1), times the largest, or B's
    own precision, `precision_of`, if that is more: beyond it, vectors are rounding errors. A B that
    is not finite is a ValueError, and so is a tolerance out of range.
    """
    if not 0 < rank_tolerance < 1:
        raise InputError(f"the rank tolerance must lie between 0 and 1, not {rank_tolerance}")
    cast = cast_columns(B)
    if cast.any() and not cast.all():  # their rounding must not hide what the others resolve
        Q = background_basis(B[:, ~cast], rank_tolerance)
        return joined_basis(Q, B[:, cast])
    rank_tolerance = max(rank_tolerance, precision_of(B))
    B = np.asarray(B, np.float64)
    if not np.isfinite(B).all():
        raise InputError("B must be finite")
    norms = np.sqrt(np.einsum("ij,ij->j", B, B))
    if not norms.any():
        return np.zeros((B.shape[0], 0))
    scale: Array = np.divide(1, norms, where=norms > 0, out=norms * 0)
    sketched = _sketched_basis(B, scale, rank_tolerance)
    if sketched is not None:
        return sketched
    # The SVD of the triangular factor of a QR decomposition: several times faster than B's own.
    orthonormal, R = np.linalg.qr(B[:, norms > 0] / norms[norms > 0])
    U, σ, _ = linalg.svd(R, full_matrices=False)
    return np.asarray(orthonormal @ U[:, σ > rank_tolerance * σ[0]])


def joined_basis(Q: Array, columns: Image) -> Array:
    """Return an orthonormal basis of range(Q), (M, r), and of a few columns, (M, K), beside it.

    Q is orthonormal. The basis includes a column however little of it lies outside of range(Q),
    unless that is rounding in the precision of the columns.
    """
    outside = np.asarray(columns, np.float64)
    outside = outside / np.maximum(np.linalg.norm(outside, axis=0), np.finfo(np.float64).tiny)
    for _ in range(2):  # the second pass removes what rounding left
        outside = outside - Q @ (Q.T @ outside)
    U, σ, _ = np.linalg.svd(outside, full_matrices=False)
    return np.hstack([Q, U[:, σ > max(ROUNDING, precision_of(columns))]])


def wall_profiles(shape: tuple[int, int]) -> Array:
    """Return fields over a photograph that vary down or across alone, (rows · columns, K).

    They are Legendre polynomials of degree at most `PROFILE_DEGREE`, lower for small photographs.
    Edges of tables, sills and window frames, and lamps nearby, cast light that far point lights do
    not explain; most of it varies along one side of the wall only.
    """
    rows, columns = shape
    degrees = np.minimum(PROFILE_DEGREE, np.floor_divide(shape, PIXELS_A_DEGREE)).tolist()
    sides = (np.linspace(-1, 1, size) for size in shape)
    down, across = map(legendre.legvander, sides, degrees)  # each with a constant, needed once
    return np.hstack([np.repeat(down[:, 1:], columns, axis=0), np.tile(across, (rows, 1))])


def _sketched_basis(B: Image, scale: Array, rank_tolerance: float) -> Array | None:
    """Return the basis from products of scaled B with a few random vectors, if so few suffice.

    Halko, Martinsson, Tropp, "Finding structure with randomness", 2011, Sec. 1.5: where the last
    singular value within the sketch is far below the tolerance, nothing above it lies outside.
    """
    if B.shape[1] <= 2 * SKETCH:
        return None
    random = np.random.default_rng(0).standard_normal((B.shape[1], SKETCH))
    mixtures = B @ (scale[:, np.newaxis] * random)
    S, _ = np.linalg.qr(mixtures)
    U, σ, _ = np.linalg.svd((S.T @ B) * scale, full_matrices=False)
    if σ[-1] > SKETCHED * rank_tolerance * σ[0]:
        return None
    return np.asarray(S @ U[:, σ > rank_tolerance * σ[0]])


LARGEST_GRAM = 5e10
"""M N² up to which `unexplained` forms A⊥ᵀA⊥: a second or two."""

FEW = 48
"""Vectors up to which a product by rows is faster than BLAS; see `products`."""

RIDGE = float(np.sqrt(np.finfo(np.float64).eps))
"""Fraction of A⊥ᵀA⊥'s mean diagonal added as a ridge, where that matrix is inverted."""

NOTHING_LEFT = "B explains all of A, as where no occluder casts a shadow, or pixels are few"


class TransportOperator(LinearOperator):  # type: ignore[misc]  # SciPy has no types
    """A⊥ = A − Q QᵀA as a SciPy linear operator, by passes over A's rows.

    A is (M, N), an array or memory map of real numbers; Q is (M, r) orthonormal columns, or None.
    `QtA` is QᵀA, (r, N); the squared norms are ‖A‖_F², of the whole, and ‖A⊥‖_F². It raises a
    ValueError if A is no such matrix or not finite, the rows of Q do not match A's, or A⊥ is
    nothing.
    """

    def __init__(self, A: Image, Q: Array | None = None) -> None:
        A = checked_matrix(A, "A")
        super().__init__(np.dtype(np.float64), A.shape)
        self.A = A
        self.Q = np.zeros((A.shape[0], 0)) if Q is None else np.ascontiguousarray(Q)
        if len(self.Q) != A.shape[0]:
            raise InputError(f"B has {len(self.Q)} rows; they must match the {A.shape[0]} of A")
        self.QtA = np.zeros((self.Q.shape[1], A.shape[1]))
        self.whole_squared_norm = 0.0
        for rows, block in self._blocks():
            self.QtA += self.Q[rows].T @ block
            self.whole_squared_norm += float(np.vdot(block, block))
        if not np.isfinite(self.whole_squared_norm):
            raise InputError("A must be finite")
        self.squared_norm = self.whole_squared_norm - float(np.vdot(self.QtA, self.QtA))
        if not self.squared_norm > ROUNDING * self.whole_squared_norm:
            raise InputError(NOTHING_LEFT)

    def project_out(self, y: Image) -> Array:
        """Return photographs, (M, K), with range(Q) projected out: y − Q Qᵀ y."""
        return np.asarray(y - self.Q @ (self.Q.T @ y))

    def unexplained(self, y: Image) -> Array:
        """Return what no hidden image and no background explain of photographs, (M, K).

        Where A is too large for A⊥ᵀA⊥, only range(Q) is projected out.
        """
        y = self.project_out(y)
        if self.shape[0] * self.shape[1] ** 2 > LARGEST_GRAM:
            return y
        images = linalg.cho_solve(self._cholesky, self.rmatmat(y))
        return np.asarray(y - self.matmat(images))

    @cached_property
    def _cholesky(self) -> tuple[Array, bool]:
        gram = self.gram.copy()
        gram[np.diag_indices_from(gram)] += RIDGE * np.trace(gram) / len(gram)
        factor: tuple[Array, bool] = linalg.cho_factor(gram)
        return factor

    @cached_property
    def gram(self) -> Array:
        """A⊥ᵀA⊥, (N, N), by one pass."""
        gram = np.zeros((self.shape[1], self.shape[1]))
        for rows, block in self._blocks():
            rest = block - self.Q[rows] @ self.QtA  # squared, it has no negative eigenvalue
            gram += rest.T @ rest
        return gram

    def light(self, f: Array) -> Array:
        """Return A f, (M, K), backgrounds and all, of f, (N, K)."""
        y = np.empty((self.shape[0], f.shape[1]))
        for rows, block in self._blocks():
            y[rows] = block @ f
        return y

    def quick_light(self, f: Array) -> Array:
        """Return A f in single precision, at the speed of memory."""
        y, images = np.empty((self.shape[0], f.shape[1])), np.ascontiguousarray(f.T, np.float32)
        for rows, block in self._blocks(self.shape[0], np.float32):
            y[rows] = products.times_rows(images, block).T
        return y

    def _matmat(self, f: Array) -> Array:
        return self.project_out(self.light(f))

    def _rmatmat(self, y: Array) -> Array:
        projected = self.project_out(y)
        f = np.zeros((self.shape[1], y.shape[1]))
        for rows, block in self._blocks():
            f += block.T @ projected[rows]
        return f

    def light_of(self, images: Image) -> Image:
        """Return A⊥ of images, (K, N), as rows, (K, M), in their precision, by one pass."""
        light = np.empty((len(images), self.shape[0]), images.dtype)
        QtA = self.QtA.astype(images.dtype)
        for rows, block in self._blocks(1024, images.dtype):
            # Rows of A⊥ are smaller than those of A, and so are their products' roundings.
            light[:, rows] = images @ (block - self.Q[rows].astype(images.dtype) @ QtA).T
        return light

    def images_of(self, light: Image) -> Image:
        """Return Aᵀ of light, (K, M), as rows, (K, N), in single precision, by one pass."""
        images = np.zeros((len(light), self.shape[1]), np.float32)
        few = len(light) <= FEW
        for rows, block in self._blocks(self.shape[0] if few else 1024, np.float32):
            own = light[:, rows]
            images += (
                products.combine_rows(np.ascontiguousarray(own), block) if few else own @ block
            )
        return images

    def _blocks(
        self, count: int = 256, dtype: DTypeLike = np.float64
    ) -> Iterator[tuple[slice, Image]]:
        for start in range(0, len(self.A), count):
            part = np.asarray(self.A[start : start + count], dtype)
            yield slice(start, start + len(part)), part
