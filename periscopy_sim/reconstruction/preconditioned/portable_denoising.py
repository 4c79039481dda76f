"""Total variation and repair in the array API standard, for arrays on any device.

The same problems as in `total_variation` and `repair`, whose compiled loops are faster on a
processor; here all images of a batch advance together, as suits a graphics card, until the last
has converged.
"""

from __future__ import annotations

import math
from collections.abc import Iterator
from typing import Any

from array_api_compat import array_namespace

Array = Any
"""An array of any library that keeps the array API standard."""

GAP_INTERVAL = 10
RESOLVED = 16
"""Relative duality gaps below this many roundings are left to double precision."""


def prox_total_variation(
    images: Array,
    weight: Array,
    *,
    temporal_weight: float | None = None,
    previous: Array | None = None,
    l1_weight: Array | None = None,
    tolerance: float = 1e-4,
    max_iterations: int = 10_000,
) -> Array:
    """Proximal operators of total variation: Eq. 11, its video form, and Eq. 12.

    argmin_f ‖f − g‖₂² + λ‖f‖_TV [+ λ₂‖f − p‖₁], all images at once until the last has converged.

    Parameters
    ----------
    images
        g, (..., R, C), or (..., T, R, C) with a temporal weight; real floating-point, finite.
    weight
        λ ≥ 0, of the leading shape (...).
    temporal_weight
        Weight > 0 of the difference to the next frame; None for images without time.
    previous, l1_weight
        p, like the images, and λ₂ > 0, like the weight; or None.
    tolerance
        Stop when each relative duality gap is at most this.
    max_iterations
        Give up after so many iterations.

    Returns
    -------
    array
        f, like the images, on their device.
    """
    xp = array_namespace(images)
    steps = [1.0, 1.0] if temporal_weight is None else [temporal_weight, 1.0, 1.0]
    axes = tuple(range(-len(steps), 0))
    weight = xp.reshape(weight, (*weight.shape, *(1 for _ in axes)))
    mean = xp.mean(images, axis=axes, keepdims=True)
    g = images - mean
    peak = xp.max(xp.abs(g), axis=axes, keepdims=True)
    peak = xp.where(peak > 0, peak, xp.ones_like(peak))
    g, bound = g / peak, weight / peak / 2
    flat = bound >= _flattening_bound(xp, g, temporal_weight)
    pull = None
    if previous is not None:
        most = xp.reshape(l1_weight, weight.shape) / peak / 2
        pull = (previous - mean) / peak, most
        flat = flat & (most == 0)
    bound = xp.where(flat, xp.zeros_like(bound), bound)
    energy = _sum(xp, g * g, axes)
    size = math.prod(images.shape[axis] for axis in axes)
    rounding = RESOLVED * float(xp.finfo(g.dtype).eps)
    if g.dtype != xp.float64 and bool(
        xp.any(rounding * (energy + 2 * size * bound**2) > tolerance * energy)
    ):
        g, bound = (xp.astype(part, xp.float64) for part in (g, bound))
        pull = pull and tuple(xp.astype(part, xp.float64) for part in pull)
    weighted = list(zip(axes, steps, strict=True))
    f = _minimize(xp, g, bound, pull, weighted, tolerance, max_iterations)
    f = mean + peak * xp.astype(f, images.dtype)
    return xp.where(flat, mean * xp.ones_like(f), f)


def repair(images: Array, threshold: Array, previous: Array | None = None) -> Array:
    """Replace the patches whose magnitude is far from their neighbours' mean (Algorithm 2).

    Parameters
    ----------
    images
        f̄, (K, R, C, channels).
    threshold
        (K,) κ ≥ 0.
    previous
        (K, R, C, channels) the frames before them, which widen the window to 3 x 3 x 2; or None.

    Returns
    -------
    array
        The repaired images, see `repair.repair` for the rules.
    """
    xp = array_namespace(images)
    magnitude = magnitudes(images)
    around = list(_window(xp, magnitude))
    total = sum(xp.where(inside, values, 0.0) for values, inside, centre in around if not centre)
    count = sum(xp.astype(inside, magnitude.dtype) for _, inside, centre in around if not centre)
    alone = count == 0
    mean = total / xp.where(alone, xp.ones_like(count), count)
    far = (xp.abs(magnitude - mean) > threshold[:, None, None]) & ~alone
    window = [(values, inside) for values, inside, _ in _window(xp, images)]
    if previous is not None:
        window = [part[:2] for part in _window(xp, images) if not part[2]]
        window += [part[:2] for part in _window(xp, previous)]
    return xp.where(far[..., None], _median(xp, window), images)


def magnitudes(images: Array) -> Array:
    """Norm of each patch over the channels, (K, R, C) float64: squares of any unit fit in it."""
    xp = array_namespace(images)
    wide = xp.astype(images, xp.float64)
    return xp.sqrt(xp.sum(wide * wide, axis=-1))


def percentile(values: Array, percent: float) -> Array:
    """Percentile of each row of (K, n) values, linear between the two nearest: (K,)."""
    xp = array_namespace(values)
    ordered = xp.sort(values, axis=-1)
    position = percent / 100 * (values.shape[-1] - 1)
    low = int(position)
    high = min(low + 1, values.shape[-1] - 1)
    return ordered[..., low] + (position - low) * (ordered[..., high] - ordered[..., low])


def _minimize(
    xp: Any,
    g: Array,
    bound: Array,
    pull: tuple[Array, Array] | None,
    axes: list[tuple[int, float]],
    tolerance: float,
    max_iterations: int,
) -> Array:
    """FGP with restart (Beck and Teboulle 2009; O'Donoghue and Candès 2015)."""
    every = tuple(axis for axis, _ in axes)
    step = 1 / sum(4 * weight**2 for _, weight in axes)
    dual = [xp.zeros_like(g) for _ in axes]
    extrapolated = dual
    t = xp.ones_like(bound)
    f = g
    for iteration in range(1, max_iterations + 1):
        f = _shrunk(xp, g + _divergence(xp, extrapolated, axes), pull)
        raised = [r + step * d for r, d in zip(extrapolated, _gradient(xp, f, axes), strict=True)]
        length = _length(xp, raised)
        shrink = xp.where(length > bound, bound / xp.where(length > bound, length, 1.0), 1.0)
        new = [shrink * part for part in raised]
        change = [a - b for a, b in zip(new, dual, strict=True)]
        uphill = sum(
            _sum(xp, (r - a) * c, every) for r, a, c in zip(extrapolated, new, change, strict=True)
        )
        t_next = (1 + xp.sqrt(1 + 4 * t * t)) / 2
        momentum = xp.where(uphill > 0, xp.zeros_like(t), (t - 1) / t_next)
        t = xp.where(uphill > 0, xp.ones_like(t), t_next)
        dual = new
        extrapolated = [a + momentum * c for a, c in zip(new, change, strict=True)]
        if iteration % GAP_INTERVAL == 0 or iteration == max_iterations:
            f = _shrunk(xp, g + _divergence(xp, dual, axes), pull)
            gradient = _gradient(xp, f, axes)
            variation = bound * _length(xp, gradient)
            product = sum(d * q for d, q in zip(gradient, dual, strict=True))
            gap = _sum(xp, variation - product, every)
            terms = variation + (f - g) ** 2 / 2
            if pull is not None:
                terms = terms + pull[1] * xp.abs(f - pull[0])
            objective = _sum(xp, terms, every)
            if bool(xp.all(gap <= tolerance * objective)):
                break
    return f


def _shrunk(xp: Any, f: Array, pull: tuple[Array, Array] | None) -> Array:
    """Move each value towards p by τ₂, at most onto it (soft threshold)."""
    if pull is None:
        return f
    towards, most = pull
    distance = f - towards
    size = xp.abs(distance)
    return towards + xp.sign(distance) * xp.where(size > most, size - most, xp.zeros_like(size))


def _gradient(xp: Any, f: Array, axes: list[tuple[int, float]]) -> list[Array]:
    """Weighted forward differences, zero in the last place of each axis."""
    return [
        weight * xp.concat([xp.diff(f, axis=axis), _edge(xp, f, axis)], axis=axis)
        for axis, weight in axes
    ]


def _divergence(xp: Any, field: list[Array], axes: list[tuple[int, float]]) -> Array:
    """Minus the adjoint of `_gradient`, of fields that vanish in the last place of each axis."""
    return sum(
        weight * xp.diff(xp.concat([_edge(xp, part, axis), part], axis=axis), axis=axis)
        for part, (axis, weight) in zip(field, axes, strict=True)
    )


def _edge(xp: Any, f: Array, axis: int) -> Array:
    shape = list(f.shape)
    shape[axis] = 1
    return xp.zeros(tuple(shape), dtype=f.dtype, device=_device(f))


def _length(xp: Any, field: list[Array]) -> Array:
    return xp.sqrt(sum(part * part for part in field))


def _sum(xp: Any, values: Array, axes: tuple[int, ...]) -> Array:
    total = xp.sum(values, axis=axes, keepdims=True, dtype=xp.float64)
    return xp.astype(total, values.dtype)


def _flattening_bound(xp: Any, g: Array, temporal_weight: float | None) -> Array:
    """Return a τ from which on the minimizer is the mean; see `dual_ascent`."""
    row_mean = xp.mean(g, axis=-1, keepdims=True)
    frame_mean = xp.mean(row_mean, axis=-2, keepdims=True)
    across = xp.cumulative_sum(g - row_mean, axis=-1)
    down = xp.cumulative_sum(row_mean - frame_mean, axis=-2)
    squared = across**2 + down**2
    axes: tuple[int, ...] = (-2, -1)
    if temporal_weight:
        squared = squared + (xp.cumulative_sum(frame_mean, axis=-3) / temporal_weight) ** 2
    if temporal_weight is not None:
        axes = (-3, *axes)
    return xp.sqrt(xp.max(squared, axis=axes, keepdims=True))


def _window(xp: Any, images: Array) -> Iterator[tuple[Array, Array, bool]]:
    """Yield the 3 x 3 neighbours of (K, R, C[, channels]), where they exist, which is the patch."""
    rows, columns = images.shape[1:3]
    device = _device(images)
    row = xp.arange(rows, device=device)[:, None]
    column = xp.arange(columns, device=device)[None, :]
    for down in (-1, 0, 1):
        for right in (-1, 0, 1):
            shifted = xp.roll(images, (-down, -right), axis=(1, 2))
            inside = (
                (row + down >= 0)
                & (row + down < rows)
                & (column + right >= 0)
                & (column + right < columns)
            )
            if images.ndim == 4:
                inside = inside[..., None]
            yield shifted, inside, down == 0 and right == 0


def _median(xp: Any, window: list[tuple[Array, Array]]) -> Array:
    """Median of those that exist; of an even number the average of the two in the middle."""
    stack = xp.stack([xp.where(inside, values, xp.inf) for values, inside in window])
    ordered = xp.sort(stack, axis=0)
    count = sum(xp.astype(inside, xp.int64) for _, inside in window)
    low, high = (count - 1) // 2, count // 2
    middle = xp.zeros_like(ordered[0, ...])
    for place in range(len(window)):
        for wanted in (low, high):
            middle = middle + xp.where(wanted == place, ordered[place, ...] / 2, 0.0)
    return middle


def _device(array: Array) -> Any:
    from array_api_compat import device

    return device(array)
