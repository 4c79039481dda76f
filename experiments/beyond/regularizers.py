"""Penalized likelihood with any of several penalties on the hidden image, many photographs at once.

    f̂ = argmin_f Σ_c w_c (½ f_cᵀ G f_c − h_cᵀ f_c) + λ R(f) + λ η ‖min(f, 0)‖²,   η = ∞ for f ≥ 0

R sums functions of the length of what linear operators make of f and of auxiliary fields: total
variation, isotropic or not, of the colour image or of each channel; Huber's, which is quadratic
where gradients are small; second-order total generalized variation; and the quadratic ½‖∇f‖².

The alternating direction method of multipliers (Boyd et al. 2011, Sec. 3) splits off K x, x = f and
the auxiliary fields. Each iteration solves (w G + ρ KᵀK) x = r. With M = KᵀK, S the Schur
complement of the auxiliary fields in M, and W = M⁻¹ S U, U the generalized eigenvectors of (G, S)
to the eigenvalues Λ, the solution is M⁻¹ r / ρ + W (1/(wΛ + ρ) − 1/ρ) Wᵀ r, for any w and ρ.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy import linalg, sparse
from scipy.sparse.linalg import splu

Array = NDArray[np.float64]
Image = NDArray[np.floating[Any]]

RELAXATION = 1.8
SHRINKAGE = 0.2
"""λ/ρ for images whose root mean square is near 1, as they are scaled here."""

CHECKED = 10
"""Iterations between two looks at the residuals."""

DIRECTIONS, CHANNELS = 0, 3
"""Axes of what an operator makes of images, (components, N, photographs, channels)."""

Factor = Callable[[Image, float], Image]
"""What the proximal operator of κφ(‖·‖) multiplies a vector by, given its length and κ."""


@dataclass(frozen=True, eq=False)
class Term:
    """One term of a penalty: the sum of φ(‖K x‖) over patches.

    Attributes
    ----------
    operator
        K, (components N, unknowns), sparse; components are the slower index of its rows.
    together
        Axes of (components, N, photographs, channels) over which the length is taken.
    factor
        Of φ's proximal operator.
    share
        The term's own weight over λ.
    """

    operator: Any
    together: tuple[int, ...]
    factor: Factor
    share: float = 1.0


@dataclass(frozen=True, eq=False)
class Problem:
    """Photographs reduced to what the hidden image is estimated from.

    Attributes
    ----------
    data
        h, (N, P, 3) for P photographs.
    trust
        w, (P, 3), near 1.
    weight
        λ of each photograph, (P,).
    """

    data: Array
    trust: Array
    weight: Array


def soft(length: Image, κ: float) -> Image:
    """Shrink by κ: φ(t) = t."""
    return np.maximum(1 - κ / np.maximum(length, 1e-30), 0)


def rounded(ε: float) -> Factor:
    """Shrink as Huber's function does: φ(t) = t²/(2ε) for t < ε, else t − ε/2."""
    return lambda length, κ: 1 - κ / np.maximum(length, κ + ε)


def damped(length: Image, κ: float) -> Image:
    """Damp: φ(t) = t²/2."""
    return np.broadcast_to(1 / (1 + κ), length.shape)


def gradient(shape: tuple[int, int]) -> Any:
    """Form ∇, (2 N, N): forward differences down and across, zero at the end."""
    down, across = (_differences(size) for size in shape)
    rows, columns = shape
    return sparse.vstack(
        [sparse.kron(down, sparse.eye(columns)), sparse.kron(sparse.eye(rows), across)]
    ).tocsr()


def total_variation(
    shape: tuple[int, int],
    *,
    together: tuple[int, ...] = (DIRECTIONS, CHANNELS),
    factor: Factor = soft,
) -> list[Term]:
    """Penalize ‖∇f‖, of the colour image unless `together` says otherwise."""
    return [Term(gradient(shape), together, factor)]


def generalized_variation(shape: tuple[int, int], ratio: float = 2.0) -> list[Term]:
    """Penalize min_v Σ‖∇f − v‖ + β Σ‖E v‖ of second order (Bredies, Kunisch and Pock 2010, Sec. 4).

    E is the symmetrized gradient, its mixed part counted twice.

    Parameters
    ----------
    shape
        (R, C) of the hidden image.
    ratio
        β.
    """
    rows, columns = shape
    patches = rows * columns
    first = sparse.hstack([gradient(shape), -sparse.eye(2 * patches)])
    # v has no place in the last row (down) or column (across), where ∇f is 0 by convention.
    down_down = sparse.kron(_differences(rows, rows - 1), sparse.eye(columns))
    across_across = sparse.kron(sparse.eye(rows), _differences(columns, columns - 1))
    across_down, down_across = gradient(shape)[patches:], gradient(shape)[:patches]
    nothing = sparse.csr_matrix((patches, patches))
    second = sparse.bmat(
        [
            [nothing, down_down, nothing],
            [nothing, nothing, across_across],
            [nothing, across_down / np.sqrt(2), down_across / np.sqrt(2)],
        ]
    )
    both = (DIRECTIONS, CHANNELS)
    return [Term(first.tocsr(), both, soft), Term(second.tocsr(), both, soft, ratio)]


class Regularized:
    """Minimize the penalized likelihood; fit once to a Gram matrix and a penalty.

    Parameters
    ----------
    gram
        G, (N, N), with a mean diagonal of 1.
    terms
        Of the penalty R.
    negatives
        What negatives cost, 2 η `SHRINKAGE`: infinity for f ≥ 0, 0 for either sign.
    tolerance, max_iterations
        Stop when both relative residuals of every photograph are at most this, or after so many.
    """

    def __init__(
        self,
        gram: Array,
        terms: list[Term],
        *,
        negatives: float = np.inf,
        tolerance: float = 1e-3,
        max_iterations: int = 2000,
    ) -> None:
        self.terms = terms
        self.negatives = negatives
        self.tolerance = tolerance
        self.max_iterations = max_iterations
        N = len(gram)
        unknowns = terms[0].operator.shape[1]
        self._image = sparse.eye(N, unknowns, format="csr")
        self._K = sparse.vstack([self._image, *(term.operator for term in terms)]).tocsr()
        self._KT = self._K.T.tocsr()
        M = (self._KT @ self._K).tocsc()
        self._auxiliary = splu(M).solve if unknowns > N else None
        if self._auxiliary is None:
            self._eigenvalues, W = linalg.eigh(gram, M.toarray())
        else:
            inverse = self._auxiliary(self._image.T.toarray())
            S = linalg.inv(inverse[:N])
            self._eigenvalues, U = linalg.eigh(gram, (S + S.T) / 2)
            W = inverse @ (S @ U)
        self._W = np.asarray(W, np.float32)
        self.iterations = 0
        self.residual = np.inf

    def minimize(self, problem: Problem) -> Array:
        """Find the image of each photograph.

        Parameters
        ----------
        problem
            The photographs.

        Returns
        -------
        ndarray
            (N, P, 3).
        """
        h, w = problem.data, problem.trust
        scale = self._scale(h, w)
        λ = np.repeat((problem.weight / scale)[:, None], 3, axis=1)
        ρ = (λ / SHRINKAGE).astype(np.float32)
        data = self._as_columns(w * h / scale[:, None])
        columns = ρ.reshape(1, -1)
        stiffness = np.outer(np.maximum(self._eigenvalues, 0), w) + columns
        weights = (1 / stiffness).astype(np.float32)
        if self._auxiliary is not None:
            weights -= 1 / columns
        u = np.zeros((self._K.shape[0], data.shape[1]), np.float32)
        p = np.zeros_like(u)
        self.residual, self.iterations = np.inf, 0
        while self.residual > self.tolerance and self.iterations < self.max_iterations:
            self.iterations += 1
            r = columns * (self._KT @ (u - p))
            r[: len(data)] += data
            x = self._W @ (weights * (self._W.T @ r))
            if self._auxiliary is not None:
                x += (self._auxiliary(r.astype(np.float64)) / columns).astype(np.float32)
            Kx = self._K @ x
            p += RELAXATION * Kx + (1 - RELAXATION) * u
            new = self._shrunk(p)
            p -= new
            if self.iterations % CHECKED == 0:
                self.residual = _residual(Kx, u, new)
            u = new
        images = u[: len(data)].reshape(h.shape)
        return np.asarray(images * scale[:, None], np.float64)

    def _scale(self, h: Array, w: Array) -> Array:
        """Return the root mean square of each photograph's image, by a little ridge regression."""
        N = h.shape[0]
        U = self._W[:N]
        ridge = U @ ((U.T @ self._as_columns(w * h)) / (self._eigenvalues[:, None] + 0.01))
        size: Array = np.sqrt(np.mean(ridge.reshape(h.shape) ** 2, axis=(0, 2)))
        return size

    def _as_columns(self, images: Array) -> Image:
        return np.ascontiguousarray(images.reshape(len(images), -1), np.float32)

    def _shrunk(self, fields: Image) -> Image:
        """Apply each term's proximal operator."""
        N = self._image.shape[0]
        shrunk = np.empty_like(fields)
        shrunk[:N] = np.maximum(fields[:N], fields[:N] / (1 + self.negatives))
        start = N
        for term in self.terms:
            stop = start + term.operator.shape[0]
            t = fields[start:stop].reshape(-1, N, fields.shape[1] // 3, 3)
            length = np.sqrt(np.sum(t * t, axis=term.together, keepdims=True))
            factor = term.factor(length, SHRINKAGE * term.share)
            shrunk[start:stop] = (t * factor).reshape(stop - start, -1)
            start = stop
        return shrunk


def _residual(Kx: Image, old: Image, new: Image) -> float:
    """Return the largest relative primal or dual residual of all photographs."""

    def size(fields: Image) -> Image:
        squares = (fields * fields).reshape(len(fields), -1, 3)
        return np.asarray(np.sqrt(np.sum(squares, axis=(0, 2))))

    gap = size(Kx - old) / np.maximum(size(Kx), size(new))
    change = size(new - old) / size(new)
    return float(max(gap.max(), change.max()))


def _differences(size: int, used: int | None = None) -> Any:
    """Forward differences of the first `used` entries, (size, size); zero in all other places."""
    matrix = np.zeros((size, size))
    for place in range((size if used is None else used) - 1):
        matrix[place, place : place + 2] = -1, 1
    return sparse.csr_matrix(matrix)
