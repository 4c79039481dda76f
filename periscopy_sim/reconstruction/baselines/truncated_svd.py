"""The inverse of A by its top singular vectors, which the paper compares with (Fig. 9)."""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy import linalg

from periscopy_sim.reconstruction.method import StillMethod
from periscopy_sim.reconstruction.observation import Mask, observation_of
from periscopy_sim.reconstruction.preconditioned.still import Reconstruction, denoise_and_repair

Array = NDArray[np.float64]
Image = NDArray[np.floating[Any]]


class TruncatedSVD(StillMethod[np.floating[Any]]):
    """The paper's method with an inverse of A by its top singular vectors in place of P (Fig. 9).

    With A = U Σ Vᵀ and k singular values kept, the estimate is V_k Σ_k⁻¹ U_kᵀ y. No background is
    rejected: what of it lies in the span of U_k ends in the image. Total variation and repair
    follow as in `Periscope`, with weights relative to the standard error of this estimate: σ times
    the root mean square of √(V_k Σ_k⁻² V_kᵀ)_jj, where σ is what U_k leaves of the photograph.

    The singular vectors are those of AᵀA, so that Σ_k⁻¹ U_kᵀ = Σ_k⁻² V_kᵀAᵀ; with a condition
    number of c among the kept, that costs c² rounding errors.

    Parameters
    ----------
    A
        (M, N) light transport matrix.
    B
        Not used: the method knows no backgrounds.
    hidden_shape
        (R, C) with R C = N.
    channel_gain
        (3,) positive colour of the wall, `Scenario.channel_gain`; None for a grey wall.
    mask
        (rows, columns) or (M,), True where the wall is to be used; None for everywhere.
    fraction
        Part of the N singular values kept, the largest; at least one is.
    tv_weight
        λ in standard errors of the estimate, as above; 0 denoises nothing.
    repair_threshold
        κ as a part of the 99th percentile of the denoised magnitudes; infinity repairs nothing.
    photograph_shape
        (rows, columns) that photographs must have; None checks the number of pixels alone.

    Raises
    ------
    ValueError
        If the shapes do not fit, the mask leaves fewer pixels than patches, A is not finite, a
        singular value that was to be kept is zero to rounding, the wall reflects nothing in a
        channel, or the fraction is out of range.
    """

    def __init__(
        self,
        A: Image,
        B: Image | None = None,  # noqa: ARG002
        *,
        hidden_shape: tuple[int, int],
        channel_gain: Image | None = None,
        mask: Mask | None = None,
        fraction: float = 0.4,
        tv_weight: float = 1.0,
        repair_threshold: float = 0.1,
        photograph_shape: tuple[int, int] | None = None,
    ) -> None:
        if not 0 < fraction <= 1:
            raise ValueError(f"the fraction of singular values is in (0, 1], not {fraction}")
        self._observation = observation_of(A, hidden_shape, channel_gain, mask, photograph_shape)
        A = self._observation.used(A)
        if not np.isfinite(A).all():
            raise ValueError("A must be finite")
        self.photograph_shape = photograph_shape
        self.hidden_shape = hidden_shape
        self.tv_weight = tv_weight
        self.repair_threshold = repair_threshold
        self._A: Array = np.asarray(A, np.float64)
        N = A.shape[1]
        self.rank = max(round(fraction * N), 1)
        energy, V = linalg.eigh(self._A.T @ self._A, subset_by_index=(N - self.rank, N - 1))
        if not energy[0] > 1e-14 * energy[-1]:
            raise ValueError(
                f"A has fewer than {self.rank} singular values above rounding: keep a smaller "
                f"fraction than {fraction}"
            )
        self.V: Array = V
        self.singular_values: Array = np.sqrt(energy)

    def told(self, found: Reconstruction) -> dict[str, Any]:
        """Return the noise and the weights that followed from it; see `StillMethod`."""
        return found.told()

    def stages(self, found: Reconstruction) -> list[tuple[str, Image]]:
        """Return the stages of Algorithm 1; see `StillMethod`."""
        return found.stages("inverted by singular vectors")

    def solve(self, photograph: Image) -> Reconstruction:
        """Recover the hidden image and keep the stages; see `reconstruct`."""
        y = self._observation.vectorized(photograph, self.photograph_shape)
        σ = self.singular_values[:, np.newaxis]
        coefficients = self.V.T @ (self._A.T @ y) / σ  # U_kᵀ y
        residual = np.sum(y**2, axis=0) - np.sum(coefficients**2, axis=0)
        noise: Array = np.sqrt(np.maximum(residual, 0) / max(len(y) - self.rank, 1))
        # The trace of V_k Σ_k⁻² V_kᵀ.
        standard_error = noise * np.sqrt(np.sum(σ**-2) / len(self.V))
        return denoise_and_repair(
            self._observation.image(self.V @ (coefficients / σ)),
            noise,
            weight=self.tv_weight * standard_error,
            repair_threshold=self.repair_threshold,
        )
