"""Total variation's dual problem by accelerated gradient projection, in compiled loops.

Minimized over f is

    ½‖f − g‖₂² + τ Σ|∇f| + τ₂‖f − p‖₁,    ∇ = (down, across[, w · to the next frame]),

with forward differences that vanish in the last row, column and frame; the second term is the
isotropic total variation. Its dual field q, of length at most τ at each pixel, and the dual
variable s of the third, each entry at most τ₂ in size, give f = g + div q − s (Chambolle 2004).
For a given q the best s is known, −s shrinks g + div q − p towards zero by τ₂, so that only q is
iterated upon: by projected gradient steps of 1/‖∇‖², with Nesterov's momentum (FGP, Beck and
Teboulle 2009), which is dropped whenever it points uphill (O'Donoghue and Candès 2015). The
duality gap is then Σ(τ|∇f| − ∇f·q), whose terms are all non-negative.

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

_GAP_INTERVAL = 10


@compiled_reordered
def minimize(
    g: Array,
    p: Array,
    shape: tuple[int, int, int],
    bound: float,
    l1_bound: float,
    temporal_weight: float | None,
    tolerance: float,
    max_iterations: int,
    relative_dual: Array,
) -> tuple[Array, int, float]:
    """Minimize ½‖f − g‖₂² + τ Σ|∇f| + τ₂‖f − p‖₁ for one channel, of numbers near 1.

    Parameters
    ----------
    g, p
        (frames · rows · columns,) of the same type.
    shape
        (frames, rows, columns).
    bound, l1_bound
        τ > 0 and τ₂ ≥ 0.
    temporal_weight, tolerance, max_iterations
        As in `dual_ascent.denoise_channels`.
    relative_dual
        (axes, frames · rows · columns) q/τ, to start from; receives that of f.

    Returns
    -------
    tuple
        f, the iterations taken and the relative duality gap.
    """
    frames, rows, columns = shape
    axes = len(relative_dual)
    margin = columns if temporal_weight is None else rows * columns
    inside = _inside(g, shape, axes)
    dual = np.zeros((axes, margin + len(g)), g.dtype)
    dual[:, margin:] = g.dtype.type(bound) * relative_dual
    extrapolated = dual.copy()
    f = np.zeros(len(g) + margin, g.dtype)
    step = 1 / _squared_norm(frames, temporal_weight)
    t = 1.0
    gap = math.inf
    iteration = 0
    while iteration < max_iterations and gap > tolerance:
        iteration += 1
        _apply_dual(g, p, l1_bound, extrapolated, columns, temporal_weight, f)
        t_next = (1 + math.sqrt(1 + 4 * t * t)) / 2
        uphill = _ascend(
            f, inside, bound, step, (t - 1) / t_next, dual, extrapolated, columns, temporal_weight
        )
        t = t_next
        if uphill > 0:
            extrapolated[:] = dual
            t = 1.0
        if iteration % _GAP_INTERVAL == 0 or iteration == max_iterations:
            _apply_dual(g, p, l1_bound, dual, columns, temporal_weight, f)
            gap = _relative_gap(g, p, f, inside, bound, l1_bound, dual, columns, temporal_weight)
    relative_dual[:] = dual[:, margin:] / g.dtype.type(bound)
    return f[: len(g)], iteration, gap


@compiled_reordered
def _squared_norm(frames: int, temporal_weight: float | None) -> float:
    """Bound ‖∇‖²: 4 for rows and for columns, and in time the eigenvalue 2 + 2 cos(π/frames)."""
    if temporal_weight is None:
        return 8.0
    return 8.0 + temporal_weight**2 * (2 + 2 * math.cos(math.pi / frames))


@compiled_reordered
def _inside(g: Array, shape: tuple[int, int, int], axes: int) -> Array:
    """Mark where each axis has a next row, column or frame, by 1; elsewhere 0."""
    frames, rows, columns = shape
    inside = np.ones((axes, frames, rows, columns), g.dtype)
    inside[0, :, rows - 1] = 0
    inside[1, :, :, columns - 1] = 0
    if axes == 3:
        inside[2, frames - 1] = 0
    return inside.reshape(axes, len(g))


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
    bound: float,
    l1_bound: float,
    dual: Array,
    columns: int,
    temporal_weight: float | None,
) -> float:
    """Return the duality gap over the primal objective at f, summed in double precision."""
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
