"""The paper's optimized preconditioner P = [I 0][A, B]^+ (Eq. 5 to 8), factored.

While range(A) and range(B) meet only in 0, the top rows of [A, B]^+ are the pseudoinverse of A with
range(B) projected out:

    P = (A⊥ᵀ A⊥)⁻¹ A⊥ᵀ,   A⊥ = A − Q Qᵀ A,   Q an orthonormal basis of range(B).

Then P A = I and P B = 0 hold together, so the minimum of Eq. 7, ‖P B‖² + ω ‖P A − I‖², is 0 for
every weight ω > 0: ω is inert and does not appear.
"""

from dataclasses import dataclass
from functools import cached_property

import numpy as np
from scipy import linalg

from periscopy_sim.model.ambient import RANK_TOLERANCE, background_basis
from periscopy_sim.model.noise import residual_noise
from periscopy_sim.numerics import Array, Image, precision_of
from periscopy_sim.numerics.products import subtract_combinations, times_rows
from periscopy_sim.numerics.validation import InputError, checked_matrix


@dataclass(frozen=True, eq=False)
class Preconditioner:
    """P in factored form; make one by `form_preconditioner`.

    Attributes
    ----------
    A
        (M, N) light transport matrix, float64.
    Q
        (M, r) orthonormal basis of the backgrounds.
    cholesky
        (N, N) upper triangular R with RᵀR = A⊥ᵀ A⊥, C-contiguous.
    """

    A: Array
    Q: Array
    cholesky: Array

    def __repr__(self) -> str:
        """Return its sizes on one line."""
        M, N = self.A.shape
        return f"Preconditioner({N} patches, {M} pixels, backgrounds of rank {self.Q.shape[1]})"

    def project_out(self, y: Image) -> Array:
        """Return photographs, (M,) or (M, K), with range(B) projected out: y − Q Qᵀ y, float64."""
        return np.asarray(y - self.Q @ (self.Q.T @ y))

    def solve(self, g: Array) -> Array:
        """Apply (A⊥ᵀ A⊥)⁻¹ to (N,) or (N, K)."""
        return np.asarray(linalg.cho_solve((self.cholesky.T, True), g, check_finite=False))

    def apply(self, y: Image) -> Array:
        """Return P y, (N,) or (N, K) float64, of photographs, (M,) or (M, K), without forming P."""
        # One step of iterative refinement: the Gram matrix squares A's condition number.
        y = self.project_out(y)
        f = self.solve(self.A.T @ y)
        residual = self.project_out(y - self.A @ f)
        return np.asarray(f + self.solve(self.A.T @ residual))

    def noise(self, y: Image, f: Image, factor: Image | None = None) -> Array:
        """Return σ of photographs, (K,), from what [A, B] leaves of them; see `residual_noise`.

        y is (K, M) with range(B) projected out, f = P y is (K, N). ‖A⊥ f‖ = ‖R f‖, R the Cholesky
        factor or a copy of it in single precision.
        """
        light = times_rows(f, self.cholesky if factor is None else factor)
        energy, explained = (np.einsum("km,km->k", rows, rows) for rows in (y, light))
        M, N = self.A.shape
        return residual_noise(energy, explained, M - N - self.Q.shape[1])

    def matrix(self) -> Array:
        """Form P itself, (N, M) float64."""
        A, Q = self.A, self.Q
        inverse, _ = linalg.lapack.dpotri(self.cholesky.T, lower=True)
        inverse += np.tril(inverse, -1).T
        P: Array = inverse @ A.T
        subtract_combinations(P, inverse @ (Q.T @ A).T, np.ascontiguousarray(Q.T))
        return P

    @cached_property
    def noise_gain(self) -> Array:
        """(N,) diagonal of P Pᵀ = (A⊥ᵀ A⊥)⁻¹: each patch's Cramér-Rao bound for unit noise."""
        inverse_factor, _ = linalg.lapack.dtrtri(self.cholesky.T, lower=True)
        return np.asarray(np.sum(inverse_factor**2, axis=0))


def form_preconditioner(
    A: Image, B: Image | None = None, *, rank_tolerance: float = RANK_TOLERANCE
) -> Preconditioner:
    """Form the optimized preconditioner of Eq. 8.

    Parameters
    ----------
    A
        (M, N) light transport matrix.
    B
        (M, L) prototype backgrounds; None or no columns gives the pseudoinverse of A.
    rank_tolerance
        Relative tolerance on B's singular values, see `background_basis`.

    Raises
    ------
    ValueError
        If A or B is no dense matrix of real numbers, the shapes do not fit, entries are not finite,
        or A with range(B) projected out has not full column rank: some patch looks like the others
        or like background.
    """
    A = checked_matrix(A, "A")
    B = np.zeros((len(A), 0)) if B is None else checked_matrix(B, "B")
    transport: Array = np.asarray(A, np.float64)
    if A.shape[0] < A.shape[1]:
        raise InputError(f"A must have at least as many rows as columns, not shape {A.shape}")
    if B.shape[0] != A.shape[0]:
        raise InputError(f"B has shape {B.shape}; its rows must match the {A.shape[0]} of A")
    if not np.isfinite(A).all():
        raise InputError("A must be finite")
    Q = background_basis(B, rank_tolerance)
    # NumPy's BLAS all along: the idle threads of a second one, SciPy's, would take the cores.
    gram = transport.T @ transport
    norms = np.sqrt(np.diag(gram))
    C = Q.T @ transport
    gram -= C.T @ C
    try:
        cholesky = np.asarray(np.linalg.cholesky(gram, upper=True), np.float64)
    except np.linalg.LinAlgError:
        cholesky = np.zeros_like(gram)
    # R_jj is the distance of column j from range(B) and the columns before it. Rounding leaves
    # about 1e-7 of the column's norm where it is 0, and the Gram matrix resolves no less.
    if (np.diag(cholesky) <= max(1e-6, precision_of(A)) * norms).any():
        dark = int((norms <= 1e-7 * norms.max()).sum())
        raise InputError(
            f"A with the backgrounds projected out has not full column rank ({A.shape[1]} patches, "
            f"{dark} of them invisible from the wall): use fewer patches or a smaller monitor, or "
            "the noise-aware method, which needs no rank"
        )
    return Preconditioner(transport, Q, cholesky)
