"""Total variation's proximal operators, channel by channel, in the image's own precision.

Each channel is shifted and scaled for `gradient_projection`, which minimizes

    ½‖f − g‖₂² + τ Σ|∇f| + τ₂‖f − p‖₁.

Where the answer is known, it is given without iterating.
"""

import math
from typing import Any

import numpy as np
from numpy.typing import NDArray

from periscopy_sim.numerics.compilation import compiled_reordered
from periscopy_sim.reconstruction.total_variation.dual_ascent import minimize

Array = NDArray[Any]

_RESOLVED = 16
"""Relative duality gaps below this many roundings are left to double precision."""


@compiled_reordered
def denoise_channels(
    images: Array,
    previous: Array,
    weights: NDArray[np.float64],
    l1_weights: NDArray[np.float64],
    temporal_weight: float | None,
    tolerance: float,
    max_iterations: int,
    start: int,
    stop: int,
    denoised: Array,
    duals: Array,
    iterations: NDArray[np.int64],
    gaps: NDArray[np.float64],
) -> None:
    """Denoise the channels `start` to `stop` of a stack of images, each on its own.

    Parameters
    ----------
    images
        (stack, frames, rows, columns, channels) float32 or float64, finite: g. Without
        `temporal_weight`, frames is 1.
    previous
        p, of the same shape and type; not read where λ₂ is 0.
    weights, l1_weights
        (stack · channels,) λ = 2τ and λ₂ = 2τ₂ of each channel.
    temporal_weight
        w > 0; None for images without time.
    tolerance, max_iterations
        Stop when the duality gap is at most this fraction of the objective, or after so many
        iterations.
    start, stop
        Which of the stack · channels to solve.
    denoised
        Like the images: receives f.
    duals
        (stack · channels, axes, frames · rows · columns) q/τ, to start from; receives that of f.
        Where f is known without iterating, it is left as it is.
    iterations, gaps
        (stack · channels,) receive the iterations taken and the relative duality gaps.
    """
    for k in range(start, stop):
        which, channel = k // images.shape[4], k % images.shape[4]
        g = p = _flat(images, which, channel)
        if l1_weights[k] > 0:
            p = _flat(previous, which, channel)
        f = denoised[which, :, :, :, channel]
        iterations[k], gaps[k] = _denoise_channel(
            g,
            p,
            weights[k],
            l1_weights[k],
            temporal_weight,
            tolerance,
            max_iterations,
            f,
            duals[k],
        )


@compiled_reordered
def _denoise_channel(
    g: NDArray[np.float64],
    p: NDArray[np.float64],
    weight: float,
    l1_weight: float,
    temporal_weight: float | None,
    tolerance: float,
    max_iterations: int,
    denoised: Array,
    relative_dual: Array,
) -> tuple[int, float]:
    """Shift and scale one channel to mean 0 and peak 1, where no sum can over- or underflow."""
    shape = denoised.shape
    rounding = float(np.finfo(denoised.dtype).eps)
    mean = _mean(g)
    peak = max(_peak(g, mean), _peak(p, mean))
    bound, l1_bound = weight / 2, l1_weight / 2
    largest = (4 if temporal_weight is None else 4 + 2 * temporal_weight) * bound  # of |div q|
    if peak == 0 or largest <= rounding * peak:
        denoised[:] = _shrunk(g, p, l1_bound).reshape(shape)
        return 0, 0.0
    g, p = (g - mean) / peak, (p - mean) / peak
    bound = bound / peak
    l1_bound = min(l1_bound, 2 * peak + largest) / peak  # |g + div q − p|, which gives p already
    if l1_bound == 0 and bound >= _flattening_bound(g.reshape(shape), temporal_weight):
        denoised[:] = mean
        return 0, 0.0

    # Where div q nearly cancels g, it is the roundings of q that count.
    energy = _energy(g)
    rounded = max(energy, _energy(p)) + 2 * len(g) * bound**2
    if _RESOLVED * rounding * rounded <= tolerance * energy:
        f, iterations, gap = minimize(
            g.astype(denoised.dtype),
            p.astype(denoised.dtype),
            shape,
            bound,
            l1_bound,
            temporal_weight,
            tolerance,
            max_iterations,
            relative_dual,
        )
        denoised[:] = (mean + peak * f).reshape(shape)
    else:
        wide, iterations, gap = minimize(
            g,
            p,
            shape,
            bound,
            l1_bound,
            temporal_weight,
            tolerance,
            max_iterations,
            relative_dual,
        )
        denoised[:] = (mean + peak * wide).reshape(shape)
    return iterations, gap


@compiled_reordered
def _flat(images: Array, which: int, channel: int) -> NDArray[np.float64]:
    return images[which, :, :, :, channel].astype(np.float64).ravel()


@compiled_reordered
def _mean(values: NDArray[np.float64]) -> float:
    """Average; of equal values exactly their value."""
    first: float = values[0]
    total = 0.0
    for deviation in values - first:
        total += deviation
    return first + total / len(values)


@compiled_reordered
def _peak(values: NDArray[np.float64], mean: float) -> float:
    peak = 0.0
    for value in values:
        peak = max(peak, abs(value - mean))
    return peak


@compiled_reordered
def _energy(values: NDArray[np.float64]) -> float:
    energy = 0.0
    for value in values:
        energy += value * value
    return energy


@compiled_reordered
def _shrunk(values: Array, towards: Array, by: float) -> Array:
    """Move each value towards another by a given amount, at most onto it (soft threshold)."""
    result = np.empty_like(values)
    for n in range(len(values)):
        distance = values[n] - towards[n]
        result[n] = values[n] - math.copysign(by, distance) if abs(distance) > by else towards[n]
    return result


@compiled_reordered
def _flattening_bound(deviation: NDArray[np.float64], temporal_weight: float | None) -> float:
    """Return a τ from which on the minimizer is the mean, for an image of mean zero.

    Any field q with div q = −g makes f = g + div q = 0 optimal for τ ≥ max|q| (Meyer's G-norm is
    the least such τ). Up to its sign, this q carries each row's deviations along the row, what
    their mean leaves over down the rows, and what the frame's mean leaves over through time.
    """
    frames, rows, columns = deviation.shape
    ahead = 0.0
    longest = 0.0
    for t in range(frames):
        frame_mean = _mean(deviation[t].ravel())
        if temporal_weight is not None:
            ahead += frame_mean / temporal_weight
        down = 0.0
        for i in range(rows):
            row_mean = _mean(deviation[t, i])
            down += row_mean - frame_mean
            across = 0.0
            for j in range(columns):
                across += deviation[t, i, j] - row_mean
                longest = max(longest, across * across + down * down + ahead * ahead)
    return math.sqrt(longest)
