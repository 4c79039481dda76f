"""The light transport matrix as an operator: passes over its rows, backgrounds projected out.

    A⊥ = A − Q QᵀA,   Q an orthonormal basis of range(B)

A pass reads a few rows, multiplies by them and, while they are in the cache, by their transpose:
A⊥ᵀA⊥ f costs one reading of A for all channels together. So A may be an array, a memory map, or
blocks of rows that are made anew in every pass. The number of threads does not change the results.
"""

from collections.abc import Iterator
from functools import cached_property
from itertools import pairwise
from typing import Any, Protocol, TypeAlias

import numpy as np
from numpy.typing import DTypeLike
from scipy import linalg
from scipy.sparse.linalg import LinearOperator, eigsh

from periscopy_sim.model.ambient import ROUNDING
from periscopy_sim.numerics import Array, Image, Mask
from periscopy_sim.numerics.machine import in_parallel
from periscopy_sim.numerics.products import combine_rows, times_rows
from periscopy_sim.numerics.validation import InputError, checked_matrix

PARTS = 16
"""Parts of a block of rows, each with a sum of its own: fixed, so that the order of sums is."""

CONVERTED = 2**16
"""Entries converted to double precision at once for A⊥ᵀA⊥ f, so that they stay in the cache."""

LARGEST_GRAM = 5e10
"""M N² up to which `unexplained` forms A⊥ᵀA⊥: a second or two."""

FEW = 48
"""Vectors up to which a product by rows is faster than BLAS; see `products`."""

RIDGE = float(np.sqrt(np.finfo(np.float64).eps))
"""Fraction of A⊥ᵀA⊥'s mean diagonal added as a ridge, where that matrix is inverted."""

NOTHING_LEFT = "B explains all of A, as where no occluder casts a shadow, or pixels are few"


class RowBlocks(Protocol):
    """A matrix that is known by blocks of consecutive rows."""

    @property
    def shape(self) -> tuple[int, int]:
        """(M, N)."""

    def row_blocks(self) -> Iterator[tuple[slice, Image]]:
        """Yield every block once, in order, with the rows that it holds."""


Matrix: TypeAlias = Image | RowBlocks


def checked_transport(A: Any) -> Matrix:
    """Return what streams its rows as it is, anything else by `checked_matrix`."""
    streams: bool = hasattr(A, "row_blocks")
    return A if streams else checked_matrix(A, "A")


def as_array(A: Matrix) -> Image:
    """Return the rows of A, (M, N), as an array."""
    return A if isinstance(A, np.ndarray) else used_rows(A, np.ones(A.shape[0], bool))


def row_blocks(A: Matrix) -> Iterator[tuple[slice, Image]]:
    """Yield the rows of an array at once, or those of `RowBlocks`."""
    if isinstance(A, np.ndarray):
        yield slice(0, len(A)), A
    else:
        yield from ((rows, checked_matrix(block, "A")) for rows, block in A.row_blocks())


def used_rows(A: Matrix, mask: Mask) -> Image:
    """Return a copy of the rows of A, (M, N), where the mask, (M,), is True."""
    return np.concatenate([block[mask[rows]] for rows, block in row_blocks(A)])


class TransportOperator(LinearOperator):  # type: ignore[misc]  # SciPy has no types
    """A⊥ = A − Q QᵀA as a SciPy linear operator, by passes over A's rows.

    A is (M, N), an array or memory map of real numbers, or `RowBlocks`; Q is (M, r) orthonormal
    columns, or None. `QtA` is QᵀA, (r, N); the squared norms are ‖A‖_F², of the whole, and ‖A⊥‖_F².
    It raises a ValueError if A is no such matrix or not finite, the rows of Q do not match A's, or
    A⊥ is nothing.
    """

    def __init__(self, A: Matrix, Q: Array | None = None) -> None:
        A = checked_transport(A)
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

    def gram_product(self, f: Array) -> Array:
        """Return A⊥ᵀA⊥ f = Aᵀ(A f − Q QᵀA f), (N, K), of f, (N, K), in one pass."""
        background = self.QtA @ f
        product = np.zeros_like(f)
        count = max(CONVERTED // len(f), 1)
        for rows, block in row_blocks(self.A):
            Q = self.Q[rows]

            def part(edges: tuple[int, int], block: Image = block, Q: Array = Q) -> Array:
                share = np.zeros_like(f)
                for start in range(*edges, count):
                    own = slice(start, min(start + count, edges[1]))
                    converted = np.asarray(block[own], np.float64)
                    share += converted.T @ (converted @ f - Q[own] @ background)
                return share

            edges = np.linspace(0, len(block), PARTS + 1).astype(int).tolist()
            for share in in_parallel(part, list(pairwise(edges))):
                product += share
        return product

    @cached_property
    def gram(self) -> Array:
        """A⊥ᵀA⊥, (N, N), by one pass."""
        gram = np.zeros((self.shape[1], self.shape[1]))
        for rows, block in self._blocks():
            rest = block - self.Q[rows] @ self.QtA  # squared, it has no negative eigenvalue
            gram += rest.T @ rest
        return gram

    def strongest_eigenvectors(self, count: int) -> tuple[Array, Array]:
        """Return the hidden images that the photograph shows best, by Lanczos iterations.

        They are the eigenvalues of A⊥ᵀA⊥, (k,), the largest first, and its eigenvectors, (N, k).
        Each of the `count`, at most N, takes some two passes.
        """
        N = self.shape[1]
        if 2 * count >= N:  # more iterations than columns
            energy, V = np.linalg.eigh(self.gram_product(np.eye(N)))
        else:
            gram = LinearOperator(
                (N, N), lambda f: self.gram_product(f.reshape(N, 1)).ravel(), dtype=np.float64
            )
            start = np.random.default_rng(0).standard_normal(N)
            energy, V = eigsh(gram, k=count, v0=start, ncv=min(N, 2 * count + 1), tol=1e-6)
        return energy[::-1][:count], np.ascontiguousarray(V[:, ::-1][:, :count])

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
            y[rows] = times_rows(images, block).T
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
            images += combine_rows(np.ascontiguousarray(own), block) if few else own @ block
        return images

    def _blocks(
        self, count: int = 256, dtype: DTypeLike = np.float64
    ) -> Iterator[tuple[slice, Image]]:
        for rows, block in row_blocks(self.A):
            for start in range(0, len(block), count):
                part = np.asarray(block[start : start + count], dtype)
                first = rows.start + start
                yield slice(first, first + len(part)), part
