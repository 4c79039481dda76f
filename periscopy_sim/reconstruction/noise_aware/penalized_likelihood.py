"""The minimization behind `noise_aware`, for one photograph or for a frame of a video.

    f̂ = argmin_{f ≥ 0} ½ Σ_c w_c ‖A⊥ Σ_k M_ck f_k − y⊥_c‖² + λ Σ ‖∇f‖ [+ λ₂ Σ ‖f − f_prev‖]

with w_c = σ²/σ_c², in units in which A⊥ᵀA⊥ has a mean diagonal of 1, and M a colour matrix that
keeps the norm of grey. The sums are over the patches; their norms are over the colours too. The
last term, in a video, is Eq. 12's, of the patches' colours: a patch keeps what it showed in the
frame before, or changes in all its channels.

The misfit couples the primaries by MᵀWM = V diag(p) Vᵀ, W = diag(w), but not the channels Vᵀf.

It is solved by the alternating direction method of multipliers (Boyd et al. 2011, Sec. 3) with
u = ∇f and v = f split off and over-relaxed; `spectral_basis` solves each iteration's equations.
"""

from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from periscopy_sim.model.fit import Evidence
from periscopy_sim.model.spectral_basis import SpectralBasis
from periscopy_sim.reconstruction.noise_aware.splitting import (
    Splitting,
    advance,
    right_hand_side,
)

Array = NDArray[np.float64]
Image = NDArray[np.floating[Any]]

RIDGE = 0.01
"""Weight of K beside A⊥ᵀA⊥ in the image that the scale is taken from."""

BLACK = 1e-3
"""Over the image's scale, root mean square: an image so dark is black."""


@dataclass(frozen=True)
class Schedule:
    """How the splitting is run, until both relative residuals (Boyd et al., Sec. 3.3) are small.

    Attributes
    ----------
    tolerance, max_iterations
        Of the residuals; after so many iterations they stop all the same.
    penalty
        λ/ρ over the image's scale: of 0.1 to 0.4, 0.2 needed the fewest iterations from black.
    weak
        Part of ρ below which a curvature is weak, see `SpectralBasis.solver`.
    renewed
        Iterations after which patterns of weak curvature are summed anew.
    """

    tolerance: float
    max_iterations: int
    penalty: float = 0.2
    weak: float = 0.0
    renewed: int = 1


@dataclass(frozen=True, eq=False)
class Minimum:
    """Where the iterations ended.

    What was split off is over the image's scale, its multipliers over λ.
    """

    image: Image  # (3, R, C) in single precision; of one channel (1, R, C)
    split: Splitting | None  # None of a photograph that shows nothing
    iterations: int
    residual: float  # the larger of the relative primal and dual one


@dataclass(frozen=True, eq=False)
class Objective:
    """The objective of one scene, for any photograph."""

    basis: SpectralBasis  # of A⊥ᵀA⊥, its mean diagonal 1
    hidden_shape: tuple[int, int]  # (R, C)
    mixing: Array  # (3, 3) M, from the monitor's primaries to the camera's channels; (1, 1) of one
    regularization: float  # λ over √N σ/2
    positive: bool  # whether f ≥ 0

    def minimize(
        self,
        evidence: Evidence,
        schedule: Schedule,
        start: Splitting | None = None,
        previous: Image | None = None,
        l1_weight: float = 0.0,
    ) -> Minimum:
        """Return the minimizer that the splitting finds from a `Minimum`'s split, or from black.

        With the frame before, `previous`, (3, R, C), ≥ 0 where f is, the weight of the distance to
        it is λ₂ = `l1_weight` λ.
        """
        σ = evidence.mean_noise
        λ = self.regularization * np.sqrt(len(self.basis.rows)) * σ / 2
        w = (σ / evidence.noise) ** 2
        p, V = np.linalg.eigh((self.mixing.T * w) @ self.mixing)
        data = V.T @ (self.mixing.T * w) @ evidence.coefficients
        ridge = self.basis.combined(data / (p[:, None] * self.basis.curvatures + RIDGE))
        scale = float(np.sqrt(np.mean(ridge**2)))
        if not scale > 0:
            return Minimum(np.zeros((len(p), *self.hidden_shape), np.float32), None, 0, 0.0)
        threshold = schedule.penalty * scale
        ρ = λ / threshold
        solve = self.basis.solver(p[:, None], ρ, data, schedule.weak)
        V = V.astype(np.float32)
        drawn_to = None
        if previous is not None and l1_weight > 0:
            drawn_to = np.ascontiguousarray(previous, np.float32)
        shape = len(p), *self.hidden_shape
        split = start.scaled(scale, threshold) if start else Splitting.zeros(shape)
        pull = l1_weight * threshold
        black = BLACK * scale * float(np.sqrt(split.v.size))
        residual, iteration = np.inf, 0
        while residual > schedule.tolerance and iteration < schedule.max_iterations:
            g = right_hand_side(split)
            f = V @ solve(V.T @ g, renew=iteration % schedule.renewed == 0)
            iteration += 1
            image = f.reshape(split.v.shape)
            residual = advance(image, split, threshold, self.positive, drawn_to, pull, black)
        return Minimum(split.v, split.scaled(1 / scale, 1 / threshold), iteration, residual)
