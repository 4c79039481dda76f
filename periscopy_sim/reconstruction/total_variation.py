"""Isotropic total variation and its proximal operators: Eq. 11, its video form, and Eq. 12.

The solver treats their dual problem, channel by channel.

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

References
----------
Rudin, Osher, Fatemi, "Nonlinear total variation based noise removal algorithms", 1992.
Chambolle, "An algorithm for total variation minimization and applications", 2004.
Beck, Teboulle, "Fast gradient-based algorithms for constrained total variation image denoising
and deblurring problems", 2009.
O'Donoghue, Candès, "Adaptive restart for accelerated gradient schemes", 2015.
"""

import math
from dataclasses import dataclass
from functools import cached_property, lru_cache
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import ArrayLike, NDArray

from periscopy_sim.hidden import Differences, Hidden, Size
from periscopy_sim.numerics import Array, validation
from periscopy_sim.numerics.products import compiled_reordered

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
    margin, (τ, τ2) = max(neighbours.strides), bounds
    q, r = np.zeros((2, axes, margin + size))
    f = np.zeros(margin + size)
    for axis in range(axes):
        for n in range(size):
            q[axis, margin + n] = r[axis, margin + n] = τ * relative_dual[axis, n]
    moved, shrink = np.empty((axes, size)), np.empty(size)
    t, gap, iteration = 1.0, math.inf, 0
    while iteration < stop[1] and gap > stop[0]:
        iteration += 1
        _apply_dual(g, p, τ2, r, neighbours, f)
        t_next = (1 + math.sqrt(1 + 4 * t * t)) / 2
        _climb(f, r, neighbours, τ, step, moved, shrink)
        momentum, t = (t - 1) / t_next, t_next
        if _extrapolate(moved, shrink, momentum, q, r) > 0:
            for axis in range(axes):
                for n in range(size):
                    r[axis, margin + n] = q[axis, margin + n]
            t = 1.0
        if iteration % GAP_INTERVAL == 0 or iteration == stop[1]:
            _apply_dual(g, p, τ2, q, neighbours, f)
            gap = _relative_gap(g, p, f, neighbours, bounds, q)
    for axis in range(axes):
        for n in range(size):
            relative_dual[axis, n] = q[axis, margin + n] / τ
    return f[:size], iteration, gap


@compiled_reordered
def _apply_dual(g: Array, p: Array, τ2: float, q: Array, neighbours: Neighbours, f: Array) -> None:
    """Set f = g + div q − s."""
    (strides, weights), margin = neighbours, q.shape[1] - len(g)
    for n in range(len(g)):
        f[n] = g[n]
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


Image = NDArray[Any]  # of the type of the image given


@dataclass(frozen=True, eq=False)
class TotalVariationResult:
    """A denoised image and how well it was solved for.

    No iteration is taken where the answer is known: the image itself for a weight of zero, its mean
    for a large one. The squared distance ‖f̂ − f‖₂² to the exact minimizer f is at most the gap
    times the objective. The dual field starts similar problems.
    """

    image: Image  # the minimizer f̂, the shape of the input
    iterations: int  # by the slowest channel
    gap: float  # the duality gap as a fraction of the objective, the largest of the channels
    tolerance: float  # the largest gap that counts as converged
    dual: Array  # (channels, axes, frames, patches) the dual field over its largest length λ/2

    def warn_unless_converged(self) -> None:
        """Warn, in the name of the caller's caller, that the tolerance was not reached."""
        validation.warn_unconverged(
            "total variation", self.iterations, self.gap, self.tolerance, stacklevel=4
        )


def prox_total_variation(
    image: ArrayLike,
    weight: ArrayLike,
    *,
    hidden: Hidden | None = None,
    tolerance: float = 1e-4,
    max_iterations: int = 10_000,
) -> Image:
    """Proximal operator of the total variation: argmin_f ‖f − g‖₂² + λ‖f‖_TV (Eq. 11).

    The data term has no factor one half. Where it has one, as in most of the literature, the
    same image belongs to the weight λ/2.

    Parameters
    ----------
    image
        g, of a floating-point type, finite: (rows, columns) or (rows, columns, channels). Each
        channel is denoised on its own.
    weight
        λ ≥ 0 in units of the image: one number, or one for each channel. Zero returns the image,
        infinity its mean.
    hidden
        Surfaces of N patches, each denoised by itself; g is then (N,) or (N, channels). None for a
        grid of equal squares.
    tolerance
        Stop when the duality gap is at most this fraction of the objective. Scaling image and
        weight together does not change when that is.
    max_iterations
        Give up after so many iterations, with a warning.

    Returns
    -------
    f, the shape and the type of the image, float32 at least and float64 at most.

    Raises
    ------
    TypeError, ValueError
        An argument is not as above.

    Warns
    -----
    RuntimeWarning
        The tolerance was not reached.
    """
    g = np.asarray(image)
    axes = 2 if hidden is None else 1
    if g.ndim not in (axes, axes + 1) or not g.size:
        names = "rows, columns" if hidden is None else "patches"
        raise validation.InputError(f"image has shape {g.shape}: give ({names}[, channels])")
    hidden = Hidden.of(g.shape[:2]) if hidden is None else hidden
    vectors = g.reshape(-1, *(g.shape[axes:] or (1,)))
    result = solve_total_variation(
        vectors, weight, hidden, tolerance=tolerance, max_iterations=max_iterations
    )
    result.warn_unless_converged()
    return result.image.reshape(g.shape)


def solve_total_variation(
    images: Image,
    weight: ArrayLike,
    hidden: Hidden,
    *,
    temporal_weight: float = 0.0,
    previous: Image | None = None,
    l1_weight: ArrayLike = 0.0,
    tolerance: float = 1e-4,
    max_iterations: int = 10_000,
    start: Array | None = None,
) -> TotalVariationResult:
    """Return a proximal operator's image with an account of its convergence, and no warning.

        argmin_f ‖f − g‖₂² + λ‖f‖_TV + λ₂‖f − p‖₁ (Eq. 11; with a previous image p, Eq. 12)

    The dual problem (Chambolle 2004) is solved by accelerated projected gradient ascent (FGP, Beck
    and Teboulle 2009) with restarts (O'Donoghue and Candès 2015), until the duality gap is small.

    The images g on hidden surfaces are (N, channels), or (frames, N, channels) of a video, whose
    total variation with a temporal weight w > 0 is that in three dimensions,
    Σ √(dx² + dy² + w² dt²) (Sec. 3.2, where w = 1). The weights are as of `prox_total_variation`;
    λ₂ ≥ 0 needs p, of the shape of g, and a finite λ. `start` is the `dual` of a similar problem,
    ignored if it is of other sizes.
    """
    validation.check_stopping(tolerance, max_iterations)
    validation.checked_number(temporal_weight, "temporal_weight", 0)
    values = validation.checked_image(images)
    if values.ndim not in (2, 3) or values.shape[-2] != hidden.patches:
        raise validation.InputError(
            f"the images have shape {values.shape}, the surfaces have {hidden.patches} patches: "
            "give ([frames, ]patches, channels)"
        )
    in_time = temporal_weight > 0 and values.ndim == 3
    frames, channels = len(values) if in_time else 1, values.shape[-1]

    def planes(each: Image) -> Array:  # (K, frames that time ties, N)
        flat = np.moveaxis(each, -1, 0).reshape(-1, frames, hidden.patches)
        return np.ascontiguousarray(flat, np.float64)

    g = p = planes(values)
    if previous is not None:
        p = planes(validation.checked_companion(previous, "previous", values))
    given = (
        np.broadcast_to(np.asarray(each, np.float64), channels) for each in (weight, l1_weight)
    )
    weights, l1_weights = (np.repeat(each, len(g) // channels) for each in given)
    if not (min(weights) >= 0 and min(l1_weights) >= 0):
        raise validation.InputError(
            f"weight {weights}, l1_weight {l1_weights}: give numbers, not negative"
        )
    if l1_weights.any() and (previous is None or np.isinf(weights).any()):
        raise validation.InputError(
            "an l1_weight needs a previous image and a finite weight beside it"
        )

    dual = np.zeros((len(g), 3 if in_time else 2, *g.shape[1:]))
    if start is not None and start.shape == dual.shape:
        dual[:] = start
    bounds, stop = (weights / 2, l1_weights / 2), (float(tolerance), int(max_iterations))
    f, iterations, gaps = np.empty(g.shape), [], []
    for name, part in hidden.slices.items():  # no surface depends on another
        differences, size = hidden.differences_by_surface[name], hidden[name].shape
        of_surface = _frames(differences, size, frames, temporal_weight if in_time else 0.0)
        own_g, own_p = (each[..., part].reshape(len(g), -1) for each in (g, p))
        own_dual = np.reshape(dual[..., part].copy(), (len(g), dual.shape[1], -1))
        solved, *account = solve_dual(own_g, own_p, bounds, of_surface, stop, own_dual)
        f[..., part] = solved.reshape(f[..., part].shape)
        dual[..., part] = own_dual.reshape(dual[..., part].shape)
        iterations.append(account[0].max())
        gaps.append(account[1].max())
    image = np.moveaxis(f.reshape(channels, *values.shape[:-1]), 0, -1).astype(values.dtype)
    return TotalVariationResult(image, int(max(iterations)), float(max(gaps)), tolerance, dual)


# A few: they are as large as images.
_frames = lru_cache(maxsize=4)(ImageGrid.of)
