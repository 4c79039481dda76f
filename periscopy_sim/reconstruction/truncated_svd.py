"""The inverse of A by its top singular vectors, which the paper compares with (Fig. 9)."""

from dataclasses import replace
from functools import cached_property
from typing import Any

import numpy as np
from scipy import linalg

from periscopy_sim.model.fit import residual_noise
from periscopy_sim.numerics import Array, Image, precision_of
from periscopy_sim.numerics.validation import InputError
from periscopy_sim.reconstruction.method import Report, StillMethod, of_all
from periscopy_sim.reconstruction.preconditioned import (
    Reconstruction,
    check_settings,
    denoise_and_repair,
)


class TruncatedSVD(StillMethod[np.floating[Any]]):
    """The method `preconditioned` with the inverse of A by its top singular vectors for P (Fig. 9).

    With A = U Σ Vᵀ and k singular values kept, the estimate is V_k Σ_k⁻¹ U_kᵀ y. No background is
    rejected but background photographs: what of it lies in the span of U_k ends in the image. Total
    variation and repair follow as in `Periscope`, with weights relative to the standard error of
    this estimate: σ times the root mean square of √(V_k Σ_k⁻² V_kᵀ)_jj, where σ is what U_k leaves
    of the photograph.

    The singular vectors are those of AᵀA, so that Σ_k⁻¹ U_kᵀ = Σ_k⁻² V_kᵀAᵀ; with a condition
    number of c among the kept, that costs c² rounding errors.

    Parameters
    ----------
    B
        Checked as by `StillMethod`, not used.
    fraction
        Part of the N singular values kept, the largest; at least one is.
    tv_weight
        λ in standard errors of the estimate, as above; 0 denoises nothing.
    repair_threshold
        κ as a part of the 99th percentile of the denoised magnitudes; infinity repairs nothing.
    A, **scene
        As of `StillMethod`, whose other errors it raises, too.

    Raises
    ------
    ValueError
        If a singular value that was to be kept is zero to rounding.
    """

    judges_scene = False

    def __init__(
        self,
        A: Image,
        B: Image | None = None,
        *,
        fraction: float = 0.4,
        tv_weight: float = 1.0,
        repair_threshold: float = 0.1,
        **scene: Any,
    ) -> None:
        super().__init__(A, B, **scene)
        self.fit = replace(self.fit, B=None)
        if not 0 < fraction <= 1:
            raise InputError(f"the fraction of singular values is in (0, 1], not {fraction}")
        check_settings(tv_weight, repair_threshold)
        self.fraction = fraction
        self.tv_weight = tv_weight
        self.repair_threshold = repair_threshold

    @cached_property
    def _singular(self) -> tuple[Array, Array]:
        """The singular values kept, (k,) ascending, and their right vectors, (N, k)."""
        N = self.hidden.patches
        rank = max(round(self.fraction * N), 1)
        energy, V = linalg.eigh(self.fit.operator.gram, subset_by_index=(N - rank, N - 1))
        if not energy[0] > max(1e-14, precision_of(self.fit.A) ** 2) * energy[-1]:
            raise InputError(
                f"A has fewer than {rank} singular values above rounding: keep a smaller fraction "
                f"than {self.fraction}"
            )
        return np.sqrt(energy), V

    def prepare(self) -> None:
        """Decompose A; see `StillMethod`."""
        _ = self._singular

    @of_all
    def report(self, photograph: Image, solution: Reconstruction) -> Report:
        """Return the stages of Algorithm 1 beside the image; see `StillMethod`."""
        stages = solution.stages("inverted by singular vectors")
        return replace(super().report(photograph, solution), stages=stages)

    @of_all
    def solve(self, photograph: Image) -> Reconstruction:
        """Recover the hidden image and keep the stages; see `reconstruct`."""
        transport, (singular_values, V) = self.fit.operator, self._singular
        σ = singular_values[:, np.newaxis]
        y = transport.project_out(self.fit.vectors(photograph))
        coefficients = V.T @ transport.rmatmat(y) / σ  # U_kᵀ y
        energy, explained = (np.sum(each**2, axis=0) for each in (y, coefficients))
        noise = residual_noise(energy, explained, len(y) - len(σ) - transport.Q.shape[1])
        # The trace of V_k Σ_k⁻² V_kᵀ.
        standard_error = noise * np.sqrt(np.sum(σ**-2) / len(V))
        estimate = V @ (coefficients / σ)
        weight = self.tv_weight * standard_error
        return denoise_and_repair(self.hidden, estimate, noise, weight, self.repair_threshold)
