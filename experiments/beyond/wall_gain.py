"""The plainest estimate of a smooth gain over the wall, of any degree: what to divide by.

With f₀ a first image and p_k polynomials over the wall, by least squares from what neither A nor B
explains,

    ĉ = argmin_c Σ_channels ‖(I − F Fᵀ)(y − Σ_k c_k p_k A f₀)‖² / σ²,   F a basis of [A, B],

and ĝ = 1 + Σ_k ĉ_k p_k. The package's own, `noise_aware.nuisance.wall_gain`, starts from the
same, of degree 2: it keeps smooth ambient light apart, asks by a test whether there is a gain at
all, and subtracts what the gain adds instead of dividing the photograph, ambient light included,
by it.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from periscopy_sim.reconstruction.noise_aware.nuisance.wall_gain import BOUNDS

Array = NDArray[np.float64]


def plain_gain(photograph: Array, light: Array, F: Array, terms: Array) -> Array:
    """Find the gain over the wall, (M,), without asking whether there is one.

    Parameters
    ----------
    photograph
        (M, 3).
    light
        (M, 3) A f₀.
    F
        Orthonormal basis of [A, B], M rows.
    terms
        (K, M) the p_k.
    """

    def unexplained(columns: Array) -> Array:
        return np.asarray(columns - F @ (F.T @ columns))

    left = unexplained(photograph)
    σ = np.sqrt(np.mean(left**2, axis=0))
    channels = [unexplained(terms.T * signal[:, None]) for signal in (light / σ).T]
    c = np.linalg.lstsq(np.vstack(channels), (left / σ).T.ravel())[0]
    return np.asarray(np.clip(1 + c @ terms, *BOUNDS))
