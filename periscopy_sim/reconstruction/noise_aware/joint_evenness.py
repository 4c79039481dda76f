"""The wall's unevenness from photographs of changing images alone, none with the monitor off.

    y_k = (1 + u) m_k + n_k,   m_k = A f_k + B e_k,   u ~ N(0, τ²) in each pixel, of all channels

Paint stays while the images change. Images and unevenness are found by turns: the m_k by the
noise-aware method from photographs evened so far, then u as the most probable,

    û = v / (1 + s²/τ²),   v = Σ m (y − m) / σ² / Σ m² / σ²,   s² = 1 / Σ m² / σ²,

sums over photographs and channels, τ² what the variance of v is beyond the mean s². One photograph
cannot tell paint from the image's own light; total variation and f ≥ 0 do so in part.
"""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray

from periscopy_sim.reconstruction.noise_aware.still import NoiseAware

Array = NDArray[np.float64]
Image = NDArray[np.floating[Any]]


def joint_evenness(method: NoiseAware, photographs: Image, *, iterations: int = 16) -> Array:
    """Return what photographs of one wall are multiplied by to show an even one.

    Parameters
    ----------
    method
        Fitted to the scene; with a mask, only the pixels used are looked at.
    photographs
        (K, rows, columns, 3), linear, of one wall and camera, of different hidden images.
    iterations
        Turns of images and unevenness.

    Returns
    -------
    ndarray
        (rows, columns), to be multiplied with every channel of every photograph; 1 where the mask
        leaves the wall out.

    Raises
    ------
    ValueError
        As `NoiseAware.reconstruct`, if there is no photograph, or the iterations are none.
    """
    given = np.asarray(photographs, np.float64)
    if given.ndim != 4 or len(given) == 0 or iterations < 1:
        raise ValueError(
            f"photographs of shape {given.shape}, {iterations} iterations: give (K, rows, columns, "
            "3) photographs, at least one of each"
        )
    observation, transport = method.observation, method.projected_transport()
    planes = observation.planar(given)
    used = slice(None) if observation.mask is None else observation.mask.ravel()
    whole, even = np.ones(observation.pixels), np.ones(planes.shape[-1])
    for _ in range(iterations):
        whole[used] = even
        evened = given * whole.reshape(*given.shape[1:3], 1)
        weighted, weights = np.zeros((2, len(even)))
        for plane, evidence in zip(planes, method.evidence(evened), strict=True):
            found, _ = method.recover(evidence)
            signal = transport.light(found.image.reshape(-1, 3)).T
            rest = plane * even - signal
            light = signal + rest - transport.reject_background(rest.T).T
            over = light / found.noise[:, None] ** 2
            weighted += np.sum(over * (plane - light), axis=0)
            weights += np.sum(over * light, axis=0)
        lit = weights > 0
        value = np.divide(weighted, weights, out=np.zeros_like(even), where=lit)
        variance = np.divide(1, weights, out=np.zeros_like(even), where=lit)
        prior = max(float(np.var(value) - np.mean(variance)), 0.0)
        shrunk = value * prior / (prior + variance + 1e-30)
        even = 1 / (1 + np.clip(shrunk, -0.5, 0.5))
    whole[used] = even
    return whole.reshape(given.shape[1:3])
