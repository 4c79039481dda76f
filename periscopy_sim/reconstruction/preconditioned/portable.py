"""The paper's method in the array API standard: for PyTorch, CuPy and other arrays.

Everything stays in the arrays' own library and on their device, from A to the hidden image.
`Periscope`, whose loops are compiled, is the fast path for NumPy arrays.
"""

from __future__ import annotations

import math
from typing import Any, Self

from array_api_compat import array_namespace, device

from periscopy_sim.reconstruction.background_subspace import RANK_TOLERANCE
from periscopy_sim.reconstruction.method import Seen, settings_of
from periscopy_sim.reconstruction.observation import check_mask
from periscopy_sim.reconstruction.preconditioned.portable_denoising import (
    Array,
    magnitudes,
    percentile,
    prox_total_variation,
    repair,
)
from periscopy_sim.reconstruction.preconditioned.video import Coupling, check_coupling


class PortablePeriscope:
    """`Periscope` for arrays of any library that keeps the array API standard.

    P is formed in double precision on the arrays' device and kept in single precision.

    Parameters
    ----------
    A
        (M, N) light transport matrix.
    B
        (M, L) prototype backgrounds, of the same library and device; None for none.
    hidden_shape
        (R, C) with R C = N.
    channel_gain
        (3,) positive colour of the wall; None for a grey wall.
    rank_tolerance
        Relative tolerance on B's singular values, see `background_basis`.
    tv_weight, repair_threshold
        As in `Periscope`.
    photograph_shape
        (rows, columns) that photographs must have; None checks the number of pixels alone.
    mask
        As in `Periscope`: a NumPy array, or one of A's library.

    Raises
    ------
    ValueError
        If the shapes do not fit, the mask leaves fewer pixels than patches, or A has not full
        column rank beside B.
    """

    def __init__(
        self,
        A: Array,
        B: Array | None = None,
        *,
        hidden_shape: tuple[int, int],
        channel_gain: Any = None,
        rank_tolerance: float = RANK_TOLERANCE,
        tv_weight: float = 1.0,
        repair_threshold: float = 0.1,
        photograph_shape: tuple[int, int] | None = None,
        mask: Any = None,
    ) -> None:
        xp = array_namespace(A) if B is None else array_namespace(A, B)
        if not (tv_weight >= 0 and repair_threshold >= 0 and 0 < rank_tolerance < 1):
            raise ValueError(
                f"tv_weight {tv_weight}, repair_threshold {repair_threshold}, rank_tolerance "
                f"{rank_tolerance}: the first two must not be negative, the last in (0, 1)"
            )
        if B is not None and (B.ndim != 2 or B.shape[0] != A.shape[0]):
            raise ValueError(
                f"B has shape {tuple(B.shape)}; its rows must match the {A.shape[0]} of A"
            )
        self.photograph_shape = photograph_shape
        self._pixels = A.shape[0]
        self._used = None
        if mask is not None:
            mask = xp.asarray(mask, device=device(A))
            shape = tuple(mask.shape) if xp.isdtype(mask.dtype, "bool") else None
            count = int(xp.sum(xp.astype(mask, xp.int64)))
            check_mask(shape, count, tuple(A.shape), photograph_shape)
            if mask.ndim == 2:
                self.photograph_shape = shape
            self._used = xp.nonzero(xp.reshape(mask, (-1,)))[0]
            A = xp.take(A, self._used, axis=0)
            B = None if B is None else xp.take(B, self._used, axis=0)
        for name, values in {"A": A, "B": B}.items():
            if values is not None and not bool(xp.all(xp.isfinite(values))):
                raise ValueError(f"{name} must be finite")
        if A.ndim != 2 or A.shape[0] < A.shape[1] or A.shape[1] != math.prod(hidden_shape):
            raise ValueError(
                f"A has shape {tuple(A.shape)}: it must have a column for each of the "
                f"{hidden_shape[0]}x{hidden_shape[1]} patches, and no fewer rows"
            )
        self.hidden_shape = hidden_shape
        self.tv_weight = tv_weight
        self.repair_threshold = repair_threshold
        gain = [1.0] * 3 if channel_gain is None else [float(value) for value in channel_gain]
        if len(gain) != 3 or not all(value > 0 for value in gain):
            raise ValueError(f"the wall's channel gains must be three positive numbers, not {gain}")
        self._gain = xp.asarray(gain, dtype=xp.float64, device=device(A))
        transport = xp.astype(A, xp.float64)
        self._basis = _background_basis(xp, transport, B, rank_tolerance)
        rejected = transport - self._basis @ (self._basis.T @ transport)
        gram = rejected.T @ rejected
        self._cholesky = _cholesky(xp, gram, transport)
        inverse = xp.linalg.inv(gram)
        P = inverse @ rejected.T
        # The Gram matrix squares A's condition number: one step of refinement.
        eye = xp.eye(A.shape[1], dtype=xp.float64, device=device(A))
        P = P + (eye - P @ transport) @ P
        self._unit_error = float(xp.mean(xp.sum(P * P, axis=1))) ** 0.5
        self._matrix = xp.astype(P, xp.float32)

    @classmethod
    def for_scene(cls, scene: Seen, A: Array, B: Array | None = None, **settings: Any) -> Self:
        """Fit to a scenario: its sizes and the colour of its wall; see `Periscope.for_scene`."""
        return cls(A, B, **settings_of(scene), **settings)

    def reconstruct(self, photograph: Array) -> Array:
        """Recover the hidden image, (R, C, 3) float32, from a photograph, (rows, columns, 3)."""
        return self.reconstruct_batch(photograph[None, ...])[0, ...]

    def reconstruct_batch(self, photographs: Array) -> Array:
        """Recover the hidden images of many photographs at once.

        Parameters
        ----------
        photographs
            (K, rows, columns, 3) or (K, M, 3) of A's library and device, linear.

        Returns
        -------
        array
            (K, R, C, 3) float32, on the same device.

        Raises
        ------
        ValueError
            If a photograph has not M pixels of 3 channels or is not finite where it is used.
        """
        xp = array_namespace(photographs, self._matrix)
        estimate, weight = self._estimate(xp, photographs)
        return self._repaired(xp, xp.moveaxis(prox_total_variation(estimate, weight), 1, -1))

    def reconstruct_next(
        self,
        photograph: Array,
        previous: Array,
        *,
        coupling: Coupling = "l1",
        temporal_weight: float = 1.0,
        l1_weight: float = 0.4,
    ) -> Array:
        """Recover the frame of a video that follows another, as `Video` does.

        Parameters
        ----------
        photograph
            (rows, columns, 3) or (M, 3) of A's library and device, linear.
        previous
            (R, C, 3) what was recovered from the photograph before it.
        coupling, temporal_weight, l1_weight
            As in `Video`.

        Returns
        -------
        array
            (R, C, 3) float32, on the same device.

        Raises
        ------
        ValueError
            As `reconstruct_batch`; the previous frame has another shape or is not finite; the
            coupling is not known, or a weight negative.
        """
        check_coupling(coupling, temporal_weight, l1_weight, self.tv_weight)
        xp = array_namespace(photograph, previous, self._matrix)
        if tuple(previous.shape) != (*self.hidden_shape, 3) or not bool(
            xp.all(xp.isfinite(previous))
        ):
            raise ValueError(
                f"the previous frame has shape {tuple(previous.shape)}: it must be finite and "
                f"{(*self.hidden_shape, 3)}"
            )
        if coupling == "none":
            return self.reconstruct(photograph)
        estimate, weight = self._estimate(xp, photograph[None, ...])
        planes = xp.astype(xp.moveaxis(previous, -1, 0), xp.float32)[None, ...]
        if coupling == "total-variation":
            pair = xp.stack([planes, estimate], axis=2)  # (1, 3, 2, R, C)
            both = prox_total_variation(pair, weight, temporal_weight=temporal_weight)
            denoised = both[:, :, 1, ...]
        else:
            denoised = prox_total_variation(
                estimate, weight, previous=planes, l1_weight=l1_weight * weight
            )
        return self._repaired(xp, xp.moveaxis(denoised, 1, -1), previous[None, ...])[0, ...]

    def _repaired(self, xp: Any, denoised: Array, previous: Array | None = None) -> Array:
        """Repair (K, R, C, 3) with thresholds that follow the images, see `repaired`."""
        if math.isinf(self.repair_threshold):
            return denoised
        rows = xp.reshape(magnitudes(denoised), (denoised.shape[0], -1))
        return repair(denoised, self.repair_threshold * percentile(rows, 99), previous)

    def _estimate(self, xp: Any, photographs: Array) -> tuple[Array, Array]:
        """P y, (K, 3, R, C), and λ, (K, 3)."""
        M = self._pixels
        expected = self.photograph_shape
        given = tuple(photographs.shape[1:])
        if math.prod(given) != 3 * M or given[-1] != 3:
            raise ValueError(f"the photograph has shape {given}; A has {M} rows")
        if expected is not None and len(given) == 3 and given[:2] != tuple(expected):
            raise ValueError(
                f"the photograph has {given[0]}x{given[1]} pixels, the scene's camera "
                f"{expected[0]}x{expected[1]}"
            )
        y = xp.reshape(photographs, (-1, M, 3))
        if self._used is not None:
            y = xp.take(y, self._used, axis=1)
            M = y.shape[1]
        y = xp.astype(y, xp.float64) / self._gain
        if not bool(xp.all(xp.isfinite(y))):
            raise ValueError("the photograph must be finite")
        y = xp.reshape(xp.moveaxis(y, -1, 1), (-1, M))  # a row for each channel
        y = y - (y @ self._basis) @ self._basis.T
        scale = xp.sqrt(xp.mean(y * y, axis=1, keepdims=True))
        scale = xp.where(scale > 0, scale, xp.ones_like(scale))
        f = scale * xp.astype(xp.astype(y / scale, xp.float32) @ self._matrix.T, xp.float64)
        explained = xp.sum((f @ self._cholesky) ** 2, axis=1)
        residual = xp.sum(y * y, axis=1) - explained
        freedom = max(M - self._matrix.shape[0] - self._basis.shape[1], 1)
        noise = xp.sqrt(xp.where(residual > 0, residual, xp.zeros_like(residual)) / freedom)
        weight = xp.astype(self.tv_weight * self._unit_error * noise, xp.float32)
        shape = (-1, 3, *self.hidden_shape)
        return xp.reshape(xp.astype(f, xp.float32), shape), xp.reshape(weight, (-1, 3))


def _background_basis(xp: Any, A: Array, B: Array | None, rank_tolerance: float) -> Array:
    """Orthonormal basis of the numerical range of B; see `preconditioner.background_basis`."""
    if B is None or B.shape[1] == 0:
        return xp.zeros((A.shape[0], 0), dtype=xp.float64, device=device(A))
    B = xp.astype(B, xp.float64)
    norms = xp.sqrt(xp.sum(B * B, axis=0))
    Q, R = xp.linalg.qr(B / xp.where(norms > 0, norms, xp.ones_like(norms)))
    U, σ, _ = xp.linalg.svd(R, full_matrices=False)
    rank = int(xp.sum(xp.astype(σ > rank_tolerance * σ[0], xp.int64)))
    return Q @ U[:, :rank]


def _cholesky(xp: Any, gram: Array, A: Array) -> Array:
    """Lower triangular factor; see `form_preconditioner` for what is refused."""
    norms = xp.sqrt(xp.sum(A * A, axis=0))
    try:
        factor = xp.linalg.cholesky(gram)
        ranked = bool(xp.all(xp.linalg.diagonal(factor) > 1e-6 * norms))
    except Exception as error:  # each library has an error of its own for this
        if type(error).__name__ not in ("LinAlgError", "_LinAlgError"):
            raise
        ranked = False
    if not ranked:
        raise ValueError(
            "A with the backgrounds projected out has not full column rank: use fewer patches or "
            "a smaller monitor"
        )
    return factor
