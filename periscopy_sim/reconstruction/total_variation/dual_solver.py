"""Total variation's proximal operators by their dual problem, channel by channel.

Minimized over f is

    ½‖f − g‖₂² + τ Σ|∇f| + τ₂‖f − p‖₁,    ∇ = (down, across[, to the next frame]),

with the forward differences of one surface; the second term is the isotropic total variation. Its
dual field q, of length at most τ at each pixel, and the dual variable s of the third, each entry at
most τ₂ in size, give f = g + div q − s (Chambolle 2004). For a given q the best s is known, −s
shrinks g + div q − p towards zero by τ₂, so that only q is iterated upon: by projected gradient
steps of 1/‖∇‖², with Nesterov's momentum (FGP, Beck and Teboulle 2009), which is dropped whenever
it points uphill (O'Donoghue and Candès 2015). The duality gap is then Σ(τ|∇f| − ∇f·q), whose terms
are all non-negative.

Images are flat in the loops. The neighbour that lies a stride on may belong to the next row or
frame, but there the weight of the difference is zero. So no loop knows a border, and all vectorize.
"""

import math
from dataclasses import dataclass
from functools import cached_property
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from periscopy_sim.hidden import Differences, Size
from periscopy_sim.numerics import Array
from periscopy_sim.numerics.compilation import compiled_reordered

GAP_INTERVAL = 10
"""Iterations between two duality gaps, each of which costs as much as one of them."""


class Neighbours(NamedTuple):
    """∇ as compiled loops read it."""

    strides: NDArray[np.int64]  # (axes,) how far on the neighbours lie
    weights: Array  # (axes, margin + pixels) of differences, 0 in a margin of the longest stride


@dataclass(frozen=True, eq=False)
class ImageGrid:
    """The frames of one surface, and ∇ over all their pixels, frame after frame."""

    shape: tuple[int, int, int]  # (frames, R, C)
    differences: Differences  # down, across, and in time where frames are tied

    @classmethod
    def of(cls, differences: Differences, size: Size, frames: int, w: float) -> "ImageGrid":
        """Return the frames of a surface, (R, C), tied in time by w, or by nothing if w is 0."""
        return cls((frames, *size), differences.over_time(frames, w) if w else differences)

    @cached_property
    def neighbours(self) -> Neighbours:
        """The strides and the weights of the differences."""
        following = self.differences.following
        strides = np.asarray((following - np.arange(following.shape[1])).max(axis=1))
        return Neighbours(strides, np.pad(self.differences.weights, ((0, 0), (strides.max(), 0))))

    @cached_property
    def largest(self) -> float:
        """A bound of |div q|/τ."""
        return 2 * float(self.differences.weights.max(axis=1).sum()) or 1.0

    def flattening_bound(self, g: Array) -> Array:
        """Return a τ from which on the minimizer is the mean, (K, 1), for (K, pixels) of mean zero.

        Any field q with div q = −g makes f = g + div q = 0 optimal for τ ≥ max|q| (Meyer's G-norm
        is the least such τ). Up to its sign, this q carries each row's deviations along the row,
        what their mean leaves over down the rows, and what the frame's mean leaves over through
        time.
        """
        images = g.reshape(-1, *self.shape)
        of_frames, of_rows = (images.mean(axis=axes, keepdims=True) for axes in ((2, 3), 3))
        flows = [
            np.cumsum(of_rows - of_frames, axis=2),
            np.cumsum(images - of_rows, axis=3),
            np.cumsum(of_frames, axis=1),
        ]
        squares = np.zeros(images.shape)
        for flow, weights in zip(flows, self.differences.weights, strict=False):
            w = weights.reshape(self.shape)
            squares += np.divide(flow, w, out=np.zeros(images.shape), where=w > 0) ** 2
        return np.asarray(np.sqrt(squares.max(axis=(1, 2, 3)))[:, None])


def solve_dual(
    g: Array,
    p: Array,
    bounds: tuple[Array, Array],
    frames: ImageGrid,
    stop: tuple[float, int],
    duals: Array,
) -> tuple[Array, NDArray[np.int64], Array]:
    """Return f, like g, and the iterations and relative duality gaps, (K,), of K channels.

    g and p are (K, pixels); p is not read where τ₂ is 0. The bounds are τ and τ₂, (K,) each. `stop`
    is the relative duality gap to stop at, and the number of iterations to give up after. The
    duals, (K, axes, pixels), are the q/τ to start from and receive that of f; where f is known
    without iterating, they stay.
    """
    τ, τ2 = (bound[:, None] for bound in bounds)
    first = g[:, :1]
    # Shifted and scaled to mean 0 and peak 1, no sum can over- or underflow.
    mean = first + (g - first).mean(axis=1, keepdims=True)
    peak = np.abs(g - mean).max(axis=1, keepdims=True)
    peak = np.maximum(peak, np.where(τ2 > 0, np.abs(p - mean).max(axis=1, keepdims=True), 0))
    largest = frames.largest * τ
    unchanged = largest <= np.finfo(np.float64).eps * peak
    scale = np.where(peak > 0, peak, 1)
    scaled, scaled_p = (g - mean) / scale, (p - mean) / scale
    flat = (τ2 == 0) & (τ / scale >= frames.flattening_bound(scaled)) & ~unchanged
    # g shrunk towards p by τ₂ (soft threshold).
    f = np.where(flat, mean, p + np.sign(g - p) * np.maximum(np.abs(g - p) - τ2, 0))
    iterations, gaps = np.zeros(len(g), np.int64), np.zeros(len(g))
    τ2 = np.minimum(τ2, 2 * peak + largest)  # which gives p already
    limits = np.hstack([τ / scale, τ2 / scale])
    step = 1 / (frames.differences.norm_bound or 1.0)
    fixed = frames.neighbours, step, stop
    for k in np.flatnonzero(~(flat | unchanged)).tolist():
        solution, iterations[k], gaps[k] = _minimize(
            scaled[k], scaled_p[k], tuple(limits[k]), *fixed, duals[k]
        )
        f[k] = mean[k] + scale[k] * solution
    return f, iterations, gaps


@compiled_reordered
def _minimize(
    g: Array,
    p: Array,
    bounds: tuple[float, float],
    neighbours: Neighbours,
    step: float,
    stop: tuple[float, int],
    relative_dual: Array,
) -> tuple[Array, int, float]:
    """Minimize for one channel of numbers near 1, from q/τ, which receives that of f.

    Returns f, the iterations taken and the relative duality gap.
    """
    axes, size = relative_dual.shape
    margin, (τ, τ2) = neighbours.strides.max(), bounds
    q = np.zeros((axes, margin + size))
    q[:, margin:] = τ * relative_dual
    r, f = q.copy(), np.zeros(margin + size)
    moved, shrink = np.empty((axes, size)), np.empty(size)
    t, gap, iteration = 1.0, math.inf, 0
    while iteration < stop[1] and gap > stop[0]:
        iteration += 1
        _apply_dual(g, p, τ2, r, neighbours, f)
        t_next = (1 + math.sqrt(1 + 4 * t * t)) / 2
        _climb(f, r, neighbours, τ, step, moved, shrink)
        momentum, t = (t - 1) / t_next, t_next
        if _extrapolate(moved, shrink, momentum, q, r) > 0:
            r[:] = q
            t = 1.0
        if iteration % GAP_INTERVAL == 0 or iteration == stop[1]:
            _apply_dual(g, p, τ2, q, neighbours, f)
            gap = _relative_gap(g, p, f, neighbours, bounds, q)
    relative_dual[:] = q[:, margin:] / τ
    return f[:size], iteration, gap


@compiled_reordered
def _apply_dual(g: Array, p: Array, τ2: float, q: Array, neighbours: Neighbours, f: Array) -> None:
    """Set f = g + div q − s."""
    (strides, weights), margin = neighbours, q.shape[1] - len(g)
    f[: len(g)] = g
    for axis in range(len(strides)):
        before = margin - strides[axis]
        ahead, behind = q[axis, margin:], q[axis, before:]
        w_ahead, w_behind = weights[axis, margin:], weights[axis, before:]
        for n in range(len(g)):
            f[n] += w_ahead[n] * ahead[n] - w_behind[n] * behind[n]
    if τ2 > 0:
        for n in range(len(g)):
            distance = f[n] - p[n]
            f[n] = f[n] - math.copysign(τ2, distance) if abs(distance) > τ2 else p[n]


@compiled_reordered
def _climb(
    f: Array, r: Array, neighbours: Neighbours, τ: float, step: float, moved: Array, shrink: Array
) -> None:
    """Set `moved` to r + step · ∇f, and `shrink` to what brings its length down to τ."""
    (strides, weights), (axes, size) = neighbours, moved.shape
    margin = r.shape[1] - size
    shrink[:] = 0
    for axis in range(axes):
        following, before, new = f[strides[axis] :], r[axis, margin:], moved[axis]
        w = weights[axis, margin:]
        for n in range(size):
            new[n] = before[n] + step * (w[n] * (following[n] - f[n]))
            shrink[n] += new[n] * new[n]
    for n in range(size):
        shrink[n] = τ / max(τ, math.sqrt(shrink[n]))


@compiled_reordered
def _extrapolate(moved: Array, shrink: Array, momentum: float, q: Array, r: Array) -> float:
    """Set q to what was moved, shrunk, and r to q + momentum · (change of q).

    Returns ⟨r − q, change of q⟩, positive where the momentum points uphill.
    """
    axes, size = moved.shape
    margin = q.shape[1] - size
    uphill = 0.0
    for axis in range(axes):
        own, extrapolated, new = q[axis, margin:], r[axis, margin:], moved[axis]
        for n in range(size):
            value = shrink[n] * new[n]
            change = value - own[n]
            uphill += (extrapolated[n] - value) * change
            own[n] = value
            extrapolated[n] = value + momentum * change
    return uphill


@compiled_reordered
def _relative_gap(
    g: Array, p: Array, f: Array, neighbours: Neighbours, bounds: tuple[float, float], q: Array
) -> float:
    """Return the duality gap over the primal objective at f."""
    (strides, weights), (τ, τ2), margin = neighbours, bounds, q.shape[1] - len(g)
    gap = objective = 0.0
    for n in range(len(g)):
        squared = product = 0.0
        for axis in range(len(strides)):
            difference = weights[axis, margin + n] * (f[n + strides[axis]] - f[n])
            squared += difference * difference
            product += difference * q[axis, margin + n]
        variation = τ * math.sqrt(squared)
        gap += variation - product
        objective += variation + (f[n] - g[n]) ** 2 / 2 + τ2 * abs(f[n] - p[n])
    return max(gap, 0.0) / objective
