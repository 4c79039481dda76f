"""What a residual looks like: which part of it each likely cause would leave.

Causes are asked for their part one after the other, each of what those before it leave: single
pixels that stand out; one place of the wall that holds most of all, where something hangs;
penumbrae that are elsewhere, as the light's derivatives along the moves that geometry makes; smooth
light; and paint, which changes all the channels by one factor.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy import fft, ndimage, optimize

Array = NDArray[np.float64]

OUTSTANDING = 6.0
"""Standard deviations beyond which a pixel is taken for a bad one."""

FEW = 0.01
"""Part of the pixels that are few."""

SMOOTH = 4
"""Cosines down and across the photograph that make smooth light."""

MOST = 3
"""Causes that are told."""

TOLD = 0.1
"""Part of what is left beyond noise from which a cause is worth telling."""


@dataclass(frozen=True)
class Cause:
    """A likely cause of a residual."""

    name: str  # of `ADVICE`
    share: float  # of the residual's energy beyond the noise's, at most 1
    place: str = ""  # in the photograph, of a cause that has one


HELD = 0.6
"""Part of what is left beyond noise that one place of the wall must hold to be told of."""

COMPACT = 0.15
"""Part of the photograph that such a place has at most."""

LOUD = 10.0
"""Variances of the noise that are left there, at least."""

ADVICE = {
    "object": "something on the wall, such as a poster, a socket or a reflection, {place} (--mask)",
    "paint": "uneven paint (--background: a photograph with the monitor off, or more of them)",
    "geometry": "a scene that is off at the edges of shadows ({calibrate}; more --samples)",
    "smooth light": "vignetting, or ambient light from nearer than the model's",
    "pixels": "single pixels (--mask)",
    "shared noise": "what neighbouring pixels share (noise of a rectified or compressed "
    "photograph, or detail that the scene lacks)",
}
"""What each cause is, for a user, and what helps."""

BESIDE_BACKGROUNDS = {
    "paint": "what no photograph with the monitor off shows ({scene}light that bounces; a camera "
    "or a wall that moved between the photographs)",
    "smooth light": "vignetting (prepare --flat), or light that was not there with the monitor off",
}
"""The same of causes that photographs with the monitor off have taken most of, if they were given:
what is left then changes like light in all colours, but is hardly paint."""


CALIBRATE = {
    False: "periscopy calibrate",
    True: "periscopy calibrate with more numbers free, or with --silhouette",
}
"""What helps where a scene is off, by whether it carries its calibration."""


def advice_for(
    causes: Sequence[Cause], *, has_backgrounds: bool, is_calibrated: bool = False
) -> str:
    """Return what likely causes are, and what helps, in order.

    Beside photographs with the monitor off, what looks like paint comes after the scene.
    """
    places = {cause.name: cause.place for cause in causes}
    names = list(places)
    told = ADVICE
    if has_backgrounds:
        told = {**ADVICE, **BESIDE_BACKGROUNDS}
        if {"paint", "geometry"} <= set(names) and names.index("paint") < names.index("geometry"):
            names.remove("paint")
            names.insert(names.index("geometry") + 1, "paint")
    calibrate = CALIBRATE[is_calibrated]
    scene = "" if "geometry" in names else f"a scene that is off: {calibrate}; "  # once
    return "; ".join(
        told[name].format(place=places[name], scene=scene, calibrate=calibrate) for name in names
    )


def likely_causes(
    residual: Array,
    whole: Array,
    signal: Array,
    noise: Array,
    unexplained: Callable[[Array], Array],
) -> tuple[Cause, ...]:
    """Return the likely causes of a residual, the largest share first.

    The residual that no hidden image explains, the photograph and its signal A f̂ are (3, rows,
    columns), NaN where pixels are left out; the noise, (3,), is what they leave of it, too.
    `unexplained` returns what hidden images and ambient light leave of (K, rows, columns) light,
    likewise.
    """
    used = np.asarray(np.isfinite(residual).all(axis=0))
    r = residual[:, used] / noise[:, None]
    beyond = float(np.sum(r**2)) - r.size
    if not beyond > 0:
        return ()
    shares: dict[str, float] = {}

    def told(name: str, left: Array) -> Array:
        nonlocal r
        shares[name] = float(np.sum(r**2) - np.sum(left**2)) / beyond
        r = left
        return left

    told("pixels", np.where(_outstanding(r), 0, r))
    there = _compact(r, used, beyond)
    told("object", np.where(there[used], 0, r))
    candidates = [
        _moves(light, noise, unexplained, used) for light in (signal, signal[:, ::-1, ::-1])
    ]
    here, elsewhere = (r - _fitted(terms, r.ravel()).reshape(r.shape) for terms in candidates)
    by_chance = float(np.sum(r**2) - np.sum(elsewhere**2)) / beyond
    told("geometry", here)
    shares["geometry"] -= by_chance
    cosines = unexplained(_cosines(used.shape))[:, used].T
    told("smooth light", r - _fitted(cosines, r.T).T)
    light = whole[:, used] / noise[:, None]
    factor = np.sum(r * light, axis=0) / (np.sum(light**2, axis=0) + 1e-30)
    common = np.sum((factor * light) ** 2, axis=0)
    slopes = np.sum(_slopes(signal)[:, used] / noise[:, None] ** 2, axis=0)
    of_paint, of_edges = _parts(common - 1, np.sum(light**2, axis=0), slopes)
    shares["paint"] = of_paint / beyond
    shares["geometry"] += of_edges / beyond
    shares["shared noise"] = float(np.sum(r**2 - 1) - np.sum(common - 1)) / beyond
    places = {"object": _told_place(there)}
    found = [
        Cause(name, min(share, 1.0), places.get(name, ""))
        for name, share in shares.items()
        if share >= TOLD
    ]
    return tuple(sorted(found, key=lambda cause: -cause.share)[:MOST])


def _outstanding(r: Array) -> NDArray[np.bool_]:
    """Return which of m pixels' (3, m) residuals stand out, where they are few."""
    energy = np.sum(r**2, axis=0)
    few = energy >= np.sort(energy)[-max(round(FEW * len(energy)), 1)]
    if energy[few].sum() > energy.sum() / 2:  # so bad that a fit spread them over the others
        return np.asarray(few)
    spread = 1.4826 * np.median(np.abs(r), axis=1, keepdims=True)
    outstanding = (np.abs(r) > OUTSTANDING * np.maximum(spread, 1)).any(axis=0)
    return np.asarray(outstanding & (outstanding.mean() <= FEW))


def _compact(r: Array, used: NDArray[np.bool_], beyond: float) -> NDArray[np.bool_]:
    """Return where, (rows, columns), one place holds most of the energy of residuals, (3, m).

    Nowhere, if none does. Paint and shadows are all over the wall, what hangs on it is not.
    """
    energy = np.zeros(used.shape)
    energy[used] = np.sum(r**2, axis=0) - len(r)
    around = ndimage.uniform_filter(energy, max(3, round(min(used.shape) / 12)), mode="constant")
    places, count = ndimage.label(around > around.max() / 4)
    held = ndimage.sum_labels(energy, places, np.arange(1, count + 1))
    place = np.asarray(places == 1 + int(np.argmax(held)))
    size = np.count_nonzero(place & used)
    holds = held.max() > max(HELD * beyond, LOUD * len(r) * size)
    return place if holds and size < COMPACT * used.sum() else np.zeros(used.shape, bool)


def _told_place(there: NDArray[np.bool_]) -> str:
    if not there.any():
        return ""
    rows, columns = (np.flatnonzero(there.any(axis=axis)) for axis in (1, 0))
    return f"in rows {rows[0]} to {rows[-1]}, columns {columns[0]} to {columns[-1]}"


def _moves(
    signal: Array,
    noise: Array,
    unexplained: Callable[[Array], Array],
    used: NDArray[np.bool_],
) -> Array:
    """Return how the residual over σ moves with the shadows, (3 m, K), in the m pixels used."""
    moves = unexplained(moved(signal).reshape(-1, *used.shape))[:, used]
    moves = moves.reshape(-1, 3, moves.shape[1]) / noise[:, None]
    return np.moveaxis(moves, 0, -1).reshape(-1, len(moves))


def moved(signal: Array) -> Array:
    """Return how (3, rows, columns) light changes as its shadows move, (K, 3, rows, columns).

    K are shifts, stretches and shears along both axes, curved ones, and a blur; where a neighbour
    is NaN they are 0.
    """
    _, rows, columns = signal.shape
    down, across = np.gradient(signal, axis=(1, 2))
    v, u = np.linspace(-1, 1, rows)[:, None], np.linspace(-1, 1, columns)
    fields = (np.ones((rows, columns)), v + 0 * u, u + 0 * v, u * v, u * u + 0 * v, v * v + 0 * u)
    blur = np.gradient(down, axis=1) + np.gradient(across, axis=2)
    moves = np.array([*(f * d for f in fields for d in (down, across)), blur])
    return np.asarray(np.nan_to_num(moves))


def _slopes(signal: Array) -> Array:
    """Return the squared slope of (3, rows, columns) light; 0 where a neighbour is NaN."""
    down, across = np.gradient(signal, axis=(1, 2))
    return np.asarray(np.nan_to_num(down**2 + across**2))


def _parts(energy: Array, *patterns: Array) -> tuple[float, ...]:
    """Split an energy, (m,), into parts that are spread like non-negative patterns, (m,)."""
    terms = np.array([pattern / (np.linalg.norm(pattern) or 1) for pattern in patterns])
    weights, _ = optimize.nnls(terms.T, energy)
    parts = weights * terms.sum(axis=1)
    return tuple((parts * energy.sum() / (parts.sum() or 1)).tolist())


def _fitted(terms: Array, values: Array) -> Array:
    """Return the least-squares combination of terms, (m, K), nearest to values, (m,) or (m, k)."""
    sizes = np.linalg.norm(terms, axis=0)
    terms = terms[:, sizes > 0] / sizes[sizes > 0]
    return np.asarray(terms @ np.linalg.lstsq(terms, values, rcond=1e-6)[0])


def _cosines(shape: tuple[int, ...]) -> Array:
    """Return the slowest cosines over a photograph, (K, rows, columns)."""
    slowest = (np.eye(size)[: min(SMOOTH, size)] for size in shape)
    down, across = (fft.idct(waves, axis=1, norm="ortho") for waves in slowest)
    return np.array([np.outer(a, b) for a in down for b in across])
