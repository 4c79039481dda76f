"""Total variation's proximal operators in compiled loops: its dual problem, channel by channel.

Minimized over f is

    ½‖f − g‖₂² + τ Σ|∇f| + τ₂‖f − p‖₁,    ∇ = (down, across[, w · to the next frame]),

with forward differences that vanish in the last row, column and frame; the second term is the
isotropic total variation. Its dual field q, of length at most τ at each pixel, and the dual
variable s of the third, each entry at most τ₂ in size, give f = g + div q − s (Chambolle 2004).
For a given q the best s is known, −s shrinks g + div q − p towards zero by τ₂, so that only q is
iterated upon: by projected gradient steps of 1/‖∇‖², with Nesterov's momentum (FGP, Beck and
Teboulle 2009), which is dropped whenever it points uphill (O'Donoghue and Candès 2015). The
duality gap is then Σ(τ|∇f| − ∇f·q), whose terms are all non-negative.

Each channel is first shifted and scaled to mean 0 and peak 1. Where the answer is known, it is
given without iterating.

Images are flat in the loops. The neighbour that lies `stride` entries on may belong to the next
row or frame, but there the difference, and with it the dual field, is zero: `inside` holds 1
where a difference counts and 0 where it does not. So no loop knows a border, and all vectorize.
"""

import math
from typing import Any

import numpy as np
from numpy.typing import NDArray

from periscopy_sim.numerics.compilation import compiled_reordered

Array = NDArray[Any]
Bounds = tuple[float, float]
"""τ and τ₂."""

Shape = tuple[int, int, int]
"""Frames, rows and columns; without time one frame."""

Stop = tuple[float, int]
"""The relative duality gap to stop at, and the number of iterations to give up after."""

_RESOLVED = 16
"""Relative duality gaps below this many roundings are left to double precision."""

_GAP_INTERVAL = 10


@compiled_reordered
def denoise_channels(
    images: Array,
    previous: Array,
    weights: NDArray[np.float64],
    l1_weights: NDArray[np.float64],
    temporal_weight: float | None,
    stop: Stop,
    part: tuple[int, int],
    denoised: Array,
    duals: Array,
    iterations: NDArray[np.int64],
    gaps: NDArray[np.float64],
) -> None:
    """Denoise some channels of a stack, each on its own: those from `part[0]` to before `part[1]`.

    The images g are (stack, frames, rows, columns, channels), float32 or float64, finite, of one
    frame without a temporal weight w > 0; p is alike and not read where λ₂ is 0. λ = 2τ and λ₂ =
    2τ₂ are (stack · channels,). `denoised`, like g, receives f; `duals`, (stack · channels, axes,
    frames · rows · columns), hold the q/τ to start from and receive that of f, unless f is known
    without iterating. `iterations` and relative duality `gaps`, (stack · channels,), likewise; only
    channels whose iterations are negative are denoised, and stay so if the precision of `duals`,
    in which they are iterated upon, does not resolve the gap asked for.
    """
    shape = images.shape[1:4]
    for k in range(part[0], part[1]):
        if iterations[k] >= 0:
            continue
        which, channel = k // images.shape[4], k % images.shape[4]
        f = denoised[which, :, :, :, channel]
        g = p = _flat(images[which, :, :, :, channel])
        if l1_weights[k] > 0:
            p = _flat(previous[which, :, :, :, channel])
        # Shifted and scaled to mean 0 and peak 1, no sum can over- or underflow.
        mean = _mean(g)
        peak = max(_peak(g, mean), _peak(p, mean))
        bound, l1_bound = weights[k] / 2, l1_weights[k] / 2
        largest = (4 if temporal_weight is None else 4 + 2 * temporal_weight) * bound  # of |div q|
        rounding = float(np.finfo(f.dtype).eps)
        if peak == 0 or largest <= rounding * peak:
            for n in range(len(g)):
                g[n] = _shrunk(g[n], p[n], l1_bound)
            _unflatten(g, 0.0, 1.0, f)
            iterations[k], gaps[k] = 0, 0.0
            continue
        bound = bound / peak
        l1_bound = min(l1_bound, 2 * peak + largest) / peak  # |g + div q − p|: that gives p already
        g, p = _scaled(g, mean, peak), _scaled(p, mean, peak)
        if l1_bound == 0 and bound >= _flattening_bound(g.reshape(shape), temporal_weight):
            f[:] = mean
            iterations[k], gaps[k] = 0, 0.0
            continue
        # Where div q nearly cancels g, it is the roundings of q that count.
        energy = _energy(g)
        rounded = max(energy, _energy(p)) + 2 * len(g) * bound**2
        if duals.itemsize == 8 or _RESOLVED * rounding * rounded <= stop[0] * energy:
            bounds = bound, l1_bound
            own, own_p = g.astype(duals.dtype), p.astype(duals.dtype)
            scaled, iterations[k], gaps[k] = _minimize(
                own, own_p, shape, bounds, temporal_weight, stop, duals[k]
            )
            _unflatten(scaled, mean, peak, f)


@compiled_reordered
def _flat(image: Array) -> NDArray[np.float64]:
    return image.astype(np.float64).ravel()


@compiled_reordered
def _unflatten(flat: Array, mean: float, peak: float, image: Array) -> None:
    """Set an image to its flat values, scaled and shifted back."""
    frames, rows, columns = image.shape
    n = 0
    for t in range(frames):
        for i in range(rows):
            for j in range(columns):
                image[t, i, j] = mean + peak * flat[n]
                n += 1


@compiled_reordered
def _scaled(values: Array, mean: float, peak: float) -> Array:
    scaled = np.empty_like(values)
    for n in range(len(values)):
        scaled[n] = (values[n] - mean) / peak
    return scaled


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
def _shrunk(value: float, towards: float, by: float) -> float:
    """Move a value towards another by a given amount, at most onto it (soft threshold)."""
    distance = value - towards
    return value - math.copysign(by, distance) if abs(distance) > by else towards


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


@compiled_reordered
def _minimize(
    g: Array,
    p: Array,
    shape: Shape,
    bounds: Bounds,
    temporal_weight: float | None,
    stop: Stop,
    relative_dual: Array,
) -> tuple[Array, int, float]:
    """Minimize for one channel of numbers near 1, from q/τ, which receives that of f.

    Returns f, the iterations taken and the relative duality gap.
    """
    frames, rows, columns = shape
    bound, l1_bound = bounds
    margin = columns if temporal_weight is None else rows * columns
    axes = len(relative_dual)
    inside = _inside(g, shape, axes)
    dual = np.zeros((axes, margin + len(g)), g.dtype)
    for axis in range(axes):
        within, given = dual[axis, margin:], relative_dual[axis]
        for n in range(len(g)):
            within[n] = bound * given[n]
    extrapolated = dual.copy()
    f = np.zeros(len(g) + margin, g.dtype)
    step = 1 / _squared_norm(frames, temporal_weight)
    t = 1.0
    gap = math.inf
    iteration = 0
    while iteration < stop[1] and gap > stop[0]:
        iteration += 1
        _apply_dual(g, p, l1_bound, extrapolated, columns, temporal_weight, f)
        t_next = (1 + math.sqrt(1 + 4 * t * t)) / 2
        uphill = _ascend(
            f, inside, bound, step, (t - 1) / t_next, dual, extrapolated, columns, temporal_weight
        )
        t = t_next
        if uphill > 0:
            extrapolated = dual.copy()
            t = 1.0
        if iteration % _GAP_INTERVAL == 0 or iteration == stop[1]:
            _apply_dual(g, p, l1_bound, dual, columns, temporal_weight, f)
            gap = _relative_gap(g, p, f, inside, bounds, dual, columns, temporal_weight)
    for axis in range(axes):
        within, given = dual[axis, margin:], relative_dual[axis]
        for n in range(len(g)):
            given[n] = within[n] / bound
    return f[: len(g)], iteration, gap


@compiled_reordered
def _squared_norm(frames: int, temporal_weight: float | None) -> float:
    """Bound ‖∇‖²: 4 for rows and for columns, and in time the eigenvalue 2 + 2 cos(π/frames)."""
    if temporal_weight is None:
        return 8.0
    return 8.0 + temporal_weight**2 * (2 + 2 * math.cos(math.pi / frames))


@compiled_reordered
def _inside(g: Array, shape: Shape, axes: int) -> Array:
    """Mark where each axis has a next row, column or frame, by 1; elsewhere 0."""
    _, rows, columns = shape
    frame = rows * columns
    inside = np.ones((axes, len(g)), g.dtype)
    for end in range(frame, len(g) + 1, frame):
        inside[0, end - columns : end] = 0
    inside[1, columns - 1 :: columns] = 0
    if axes == 3:
        inside[2, len(g) - frame :] = 0
    return inside


@compiled_reordered
def _apply_dual(
    g: Array,
    p: Array,
    l1_bound: float,
    field: Array,
    columns: int,
    temporal_weight: float | None,
    f: Array,
) -> None:
    """Set f = g + div q − s."""
    margin = field.shape[1] - len(g)
    down, above = field[0, margin:], field[0, margin - columns :]
    across, left = field[1, margin:], field[1, margin - 1 :]
    if temporal_weight is not None:
        w = g.dtype.type(temporal_weight)
        ahead, before = field[2, margin:], field[2]
    most = g.dtype.type(l1_bound)
    for n in range(len(g)):
        value = g[n] + (down[n] - above[n]) + (across[n] - left[n])
        if temporal_weight is not None:
            value += w * (ahead[n] - before[n])
        if most > 0:
            distance = value - p[n]
            value = value - math.copysign(most, distance) if abs(distance) > most else p[n]
        f[n] = value


@compiled_reordered
def _ascend(
    f: Array,
    inside: Array,
    bound: float,
    step: float,
    momentum: float,
    dual: Array,
    extrapolated: Array,
    columns: int,
    temporal_weight: float | None,
) -> float:
    """Take one step, q ← Π(r + ∇f · step) and r ← q + momentum · (change of q).

    Π shortens what is longer than τ. Returns ⟨r − q, change of q⟩, positive where the momentum
    points uphill.
    """
    size = inside.shape[1]
    margin = dual.shape[1] - size
    real = f.dtype.type
    τ, σ, β = real(bound), real(step), real(momentum)
    below, right = f[columns:], f[1:]
    has_below, has_right = inside[0], inside[1]
    q_down, q_across = dual[0, margin:], dual[1, margin:]
    r_down, r_across = extrapolated[0, margin:], extrapolated[1, margin:]
    if temporal_weight is not None:
        w = real(temporal_weight)
        following, has_following = f[margin:], inside[2]
        q_ahead, r_ahead = dual[2, margin:], extrapolated[2, margin:]
    uphill: float = real(0)
    for n in range(size):
        down = r_down[n] + σ * (has_below[n] * (below[n] - f[n]))
        across = r_across[n] + σ * (has_right[n] * (right[n] - f[n]))
        squared = down * down + across * across
        if temporal_weight is not None:
            ahead = r_ahead[n] + σ * (w * has_following[n] * (following[n] - f[n]))
            squared += ahead * ahead
        shrink = τ / max(τ, math.sqrt(squared))
        down *= shrink
        across *= shrink
        change_down = down - q_down[n]
        change_across = across - q_across[n]
        uphill += (r_down[n] - down) * change_down + (r_across[n] - across) * change_across
        q_down[n] = down
        q_across[n] = across
        r_down[n] = down + β * change_down
        r_across[n] = across + β * change_across
        if temporal_weight is not None:
            ahead *= shrink
            change_ahead = ahead - q_ahead[n]
            uphill += (r_ahead[n] - ahead) * change_ahead
            q_ahead[n] = ahead
            r_ahead[n] = ahead + β * change_ahead
    return uphill


@compiled_reordered
def _relative_gap(
    g: Array,
    p: Array,
    f: Array,
    inside: Array,
    bounds: Bounds,
    dual: Array,
    columns: int,
    temporal_weight: float | None,
) -> float:
    """Return the duality gap over the primal objective at f, summed in double precision."""
    bound, l1_bound = bounds
    margin = dual.shape[1] - len(g)
    below, right = f[columns:], f[1:]
    has_below, has_right = inside[0], inside[1]
    q_down, q_across = dual[0, margin:], dual[1, margin:]
    if temporal_weight is not None:
        following, has_following = f[margin:], inside[2]
        q_ahead = dual[2, margin:]
    gap = 0.0
    objective = 0.0
    for n in range(len(g)):
        here = np.float64(f[n])
        down = has_below[n] * (below[n] - here)
        across = has_right[n] * (right[n] - here)
        squared = down * down + across * across
        product = down * q_down[n] + across * q_across[n]
        if temporal_weight is not None:
            ahead = temporal_weight * has_following[n] * (following[n] - here)
            squared += ahead * ahead
            product += ahead * q_ahead[n]
        variation = bound * math.sqrt(squared)
        gap += variation - product
        objective += variation + (here - g[n]) ** 2 / 2 + l1_bound * abs(here - p[n])
    return max(gap, 0.0) / objective
