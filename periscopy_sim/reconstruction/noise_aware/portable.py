"""The noise-aware method in the array API standard: for PyTorch, CuPy and other arrays.

The same minimum by the same splitting as in `penalized_likelihood`, without ambient light beyond
range(B) (`ambient_prior`), a gain over the wall, noise that the channels share (`common_noise`), or
the wall's unevenness (`unevenness`); everything from the photographs to the images stays in the
arrays' own library and on their device. All images of a batch advance together, as suits a graphics
card, until the last has converged.
`NoiseAware`, whose loops are compiled, is the fast path for NumPy arrays.
"""

from __future__ import annotations

import math
import warnings
from typing import Any

import numpy as np
from array_api_compat import array_namespace, device

from periscopy_sim.reconstruction.noise_aware.evidence import noise_of, noise_to_signal
from periscopy_sim.reconstruction.noise_aware.solver.penalized_likelihood import RIDGE
from periscopy_sim.reconstruction.noise_aware.solver.splitting import RELAXATION
from periscopy_sim.reconstruction.noise_aware.still import CHECKED, PENALTY, NoiseAware
from periscopy_sim.reconstruction.observation import check_range

Array = Any
"""An array of any library that keeps the array API standard."""


class PortableNoiseAware:
    """`NoiseAware` for arrays of one library on one device.

    Parameters
    ----------
    method
        Fitted to the scene, in NumPy. Ambient light beyond range(B), a gain over the wall, noise
        that the channels share and the wall's unevenness are not looked for; its background
        photographs count as columns of B.
    like
        An array of the library, on the device; its values do not matter.
    """

    def __init__(self, method: NoiseAware, like: Array) -> None:
        xp, where = array_namespace(like), device(like)

        def moved(values: Array, kind: Any) -> Array:
            return xp.asarray(values, dtype=kind, device=where)

        self.method = method
        self.observation = method.observation
        self._unit, self._seen = float(method._unit), method._seen
        self._transport = moved(method._transport, xp.float32)
        self._rows = moved(method._basis.rows, xp.float32)
        self._curvatures = moved(method._basis.curvatures, xp.float64)
        self._background = moved(method._background, xp.float64)
        self._gain = moved(self.observation.used_gain, xp.float64)
        mask = self.observation.mask
        self._used = None if mask is None else moved(np.flatnonzero(mask), xp.int64)

    def __repr__(self) -> str:
        """Return the method that was moved, and where to, on one line."""
        library = array_namespace(self._transport).__name__.rpartition(".")[2]
        return f"PortableNoiseAware({self.method!r}, {library}, {device(self._transport)})"

    def reconstruct(self, photograph: Array) -> Array:
        """Return the hidden image, (R, C, 3), of a photograph, (rows, columns, 3) or (M, 3)."""
        return self.reconstruct_batch(photograph[None, ...])[0, ...]

    def reconstruct_batch(self, photographs: Array) -> Array:
        """Recover the hidden images of many photographs at once.

        Errors and warnings are those of `NoiseAware.reconstruct`; a photograph too bright or dark
        for single precision is a ValueError too.

        Parameters
        ----------
        photographs
            (K, rows, columns, 3) or (K, M, 3) of the library and device, linear, in any unit.

        Returns
        -------
        array
            (K, R, C, 3) float32, on the same device, in units of the photograph's over those of A.
        """
        xp = array_namespace(photographs, self._rows)
        y = self._rejected(xp, photographs)
        level = xp.sqrt(xp.mean(y * y, axis=(1, 2), keepdims=True))
        level = xp.where(level > 0, level, xp.ones_like(level))
        y = y / level
        h = xp.astype(y, xp.float32) @ self._transport.T / self._unit
        coefficients = xp.astype(h @ self._rows.T, xp.float64)
        curvatures, rank = self._curvatures[self._seen], self._background.shape[0]
        noise = noise_of(y, coefficients[..., self._seen], curvatures, rank)
        ratio = noise_to_signal(noise, y.shape[-1], rank, curvatures.shape[0])
        weight = self.method.regularization * xp.sqrt(xp.clip(ratio, min=1.0))
        images = self._minimum(xp, coefficients, noise[..., None], weight[:, None, None])
        unit = xp.astype(level, xp.float32)[..., None] / self._unit
        return xp.moveaxis(images * unit, 1, -1)

    def _rejected(self, xp: Any, photographs: Array) -> Array:
        """Return y⊥ as (K, 3, M') planes."""
        self.observation.check_size(tuple(photographs.shape))
        y = xp.reshape(photographs, (photographs.shape[0], -1, 3))
        if self._used is not None:
            y = xp.take(y, self._used, axis=1)
        y = xp.moveaxis(xp.astype(y, xp.float64) / self._gain, -1, 1)
        if not bool(xp.all(xp.isfinite(y))):
            raise ValueError("the photograph must be finite")
        if y.shape[0]:
            largest = xp.max(xp.abs(y), axis=(1, 2))
            brightest = xp.max(largest)
            check_range(float(brightest))
            check_range(float(xp.min(xp.where(largest > 0, largest, brightest))))
        return y - (y @ self._background.T) @ self._background

    def _minimum(self, xp: Any, coefficients: Array, noise: Array, weight: Array) -> Array:
        """Return the images, (K, 3, R, C), by `splitting`, of σ, (K, 3, 1), and λ/(√N σ/2)."""
        told, shape = self.method, (-1, 3, *self.method.hidden_shape)
        rows, single = self._rows, xp.float32
        σ = xp.mean(noise, axis=1, keepdims=True)
        w = (σ / noise) ** 2
        λ = weight * math.sqrt(rows.shape[0]) * σ / 2
        data, curvature = w * coefficients, w * self._curvatures
        ridge = xp.astype(data / (curvature + RIDGE), single) @ rows
        scale = xp.astype(xp.sqrt(xp.mean(ridge**2, axis=(1, 2), keepdims=True)), xp.float64)
        threshold = PENALTY * xp.where(scale > 0, scale, xp.ones_like(scale))
        ρ = λ / threshold
        gain = xp.astype(ρ / (curvature + ρ), single)
        offset = xp.astype(data / (curvature + ρ), single)
        κ = xp.astype(threshold, single)[..., None, None]
        v = q = xp.zeros_like(xp.reshape(offset, shape))
        u = p = _gradient(xp, v)
        image, active = v, xp.ones_like(κ, dtype=xp.bool)[:, 0, ...]
        α, axes = RELAXATION, (1, 2, 3, 4)
        iteration = 0
        while iteration < told.max_iterations and bool(xp.any(active)):
            iteration += 1
            g = xp.reshape(_adjoint_gradient(xp, u - p) + v - q, offset.shape)
            f = xp.reshape((gain * (g @ rows.T) + offset) @ rows, shape)
            slope = _gradient(xp, f)
            moved = α * slope + (1 - α) * u + p
            length = xp.sqrt(xp.sum(moved**2, axis=(1, 2), keepdims=True))
            shrink = xp.clip(length - κ, min=0.0) / xp.where(length > 0, length, 1 + length)
            target = α * f + (1 - α) * v + q
            before = xp.concat([u, v[:, None, ...]], axis=1)
            now = xp.concat([slope, f[:, None, ...]], axis=1)
            u, v = shrink * moved, xp.clip(target, min=0.0) if told.positive else target
            p, q = moved - u, target - v
            image = xp.where(active, v, image)
            if iteration % CHECKED == 0 or iteration == told.max_iterations:
                after = xp.concat([u, v[:, None, ...]], axis=1)
                gap, change, size, kept = (
                    xp.sqrt(xp.sum(part**2, axis=axes))
                    for part in (now - before, after - before, now, after)
                )
                settled = gap <= told.tolerance * xp.where(size > kept, size, kept)
                settled = settled & (change <= told.tolerance * kept)
                active = active & ~xp.reshape(settled, active.shape)
        if left := int(xp.sum(xp.astype(active, xp.int64))):
            warnings.warn(
                f"noise-aware recovery stopped after {iteration} iterations, before {left} of "
                f"{image.shape[0]} images had relative residuals of at most {told.tolerance:.1e}: "
                "raise max_iterations or tolerance",
                RuntimeWarning,
                stacklevel=3,
            )
        return image


def _gradient(xp: Any, images: Array) -> Array:
    """Return ∇ of (K, 3, R, C) as (K, 2, 3, R, C)."""
    down = images[..., 1:, :] - images[..., :-1, :]
    across = images[..., :, 1:] - images[..., :, :-1]
    down = xp.concat([down, xp.zeros_like(images[..., :1, :])], axis=-2)
    across = xp.concat([across, xp.zeros_like(images[..., :, :1])], axis=-1)
    return xp.stack([down, across], axis=1)


def _adjoint_gradient(xp: Any, fields: Array) -> Array:
    """Return ∇ᵀ of (K, 2, 3, R, C)."""
    down, across = fields[:, 0, :, :-1, :], fields[:, 1, :, :, :-1]
    row, column = (xp.zeros_like(part) for part in (fields[:, 0, :, :1, :], fields[:, 1, :, :, :1]))
    return (
        xp.concat([row, down], axis=-2)
        - xp.concat([down, row], axis=-2)
        + xp.concat([column, across], axis=-1)
        - xp.concat([across, column], axis=-1)
    )
