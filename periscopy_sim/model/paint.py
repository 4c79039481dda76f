"""The wall's uneven paint, which multiplies all light, estimated without a model of the paint.

    y = (1 + u) (A f + B c) + n,   b_k = (1 + u) (B c_k) + n_k

A photograph b_k with the monitor off shows paint where no smooth light explains it,

    d_k = 1 − S b_k / b_k,   which is u / (1 + u) where its light is smooth,

S the projection on range(B). So it shows its own noise, and the edges of shadows, too. As columns
of B (`background_photographs`) they do no harm; but only paint multiplies the hidden image's light.
The photograph itself separates the two. In each channel, for all channels d_k of all b_k together,

    α̂ = argmin ‖R (y − Σ α_k d_k y)‖²,

R y being what no hidden image and no ambient light, the b_k among it, explain of y. Noise of d_k is
an error of a regressor, and shrinks its α by the ratio of paint's variance to that of both; of
paint seen in several photographs each gets the share that its noise allows; edges in the light,
which are not in A f, get none. y (1 − Σ α̂_k d_k) is what an even wall would have shown.

Is there any paint? Fields that have nothing to do with the wall explain something by chance: the
d_k moved down by one and by two thirds of the photograph measure how much. For noise alone, the
ratio of their explained energies for each α has Fisher's distribution. The columns of B account for
paint that hardly shows on the hidden image's light.
"""

from collections.abc import Mapping
from dataclasses import replace
from typing import Any

import numpy as np
from scipy import special

from periscopy_sim.model.fit import ERROR_RATE, RESOLVED, FirstImage, Fit, FittedPhotograph
from periscopy_sim.numerics import Array, Mask

DARK = 0.05
"""Fraction of the smooth light's mean below which a background photograph shows no paint."""

LARGEST_UNEVENNESS = 0.5
"""Largest unevenness that counts as paint; larger values remain uncorrected."""

WORTH = 0.05
"""Least fraction of the otherwise unexplained light that paint must explain. Below it, the noise of
the background photographs did as much harm as the correction did good."""


class Paint:
    """The correction of the wall's paint, as photographs with the monitor off show it.

    It raises a ValueError if there are none.
    """

    def __init__(self, fit: Fit) -> None:
        if not fit.monitor_off:
            raise ValueError("paint needs photographs with the monitor off")
        rows = np.concatenate(list(fit.monitor_off.values()))
        smooth = fit.background[: fit.smooth_rank].T
        self._fields = np.array([fine_structure(row, smooth) for row in rows])
        self._others = [moved(self._fields, fraction, fit.mask) for fraction in (1 / 3, 2 / 3)]
        self._fit = fit

    def __call__(
        self,
        photograph: FittedPhotograph,
        first_image: FirstImage,  # noqa: ARG002
    ) -> tuple[FittedPhotograph, Mapping[str, Any]]:
        """Return a photograph as an even wall would have shown it."""
        even = self.evenness(photograph.planes)
        if not (even != 1).any():
            return photograph, {"paint_found": False}
        return replace(photograph, planes=even * photograph.planes), {"paint_found": True}

    def evenness(self, planes: Array) -> Array:
        """Return the factors, (C, M'), of a photograph's planes that make the wall even.

        They are 1 if the wall shows no paint.
        """
        levels = np.sqrt(np.mean(planes**2, axis=1, keepdims=True))
        y = planes / np.where(levels > 0, levels, 1)
        count, kinds = len(self._fields), [self._fields, *self._others]
        terms = np.stack(kinds) * y[:, None, None]  # (C, kinds, J, M')
        rows = np.concatenate([y, terms.reshape(-1, y.shape[1])])
        rest, channels = self._fit.unexplained(rows).astype(np.float64), len(planes)
        rest, own = rest[:channels], rest[channels:].reshape(channels, len(kinds), count, -1)
        even = np.ones(planes.shape)
        explained = np.zeros((len(kinds), 2))  # energy over variance, and for how many terms
        for channel in range(channels):
            variance = float(np.mean(rest[channel] ** 2)) + 1e-14
            for kind in range(len(kinds)):
                shares, energy, rank = _fit_fields(own[channel, kind], rest[channel])
                explained[kind] += energy / variance, rank
                if kind == 0:
                    even[channel] -= shares @ self._fields
        (energy, terms), (by_chance, terms_by_chance) = explained[0], explained[1:].sum(axis=0)
        if not (terms and terms_by_chance):
            return np.ones(planes.shape)
        ratio = (energy / terms) / (by_chance / terms_by_chance + 1e-30)
        is_paint = special.fdtrc(terms, terms_by_chance, ratio) < ERROR_RATE
        matters = energy > WORTH * rest.size
        believed = np.abs(even - 1).max() < LARGEST_UNEVENNESS
        return even if is_paint and matters and believed else np.ones(planes.shape)


def fine_structure(row: Array, smooth: Array) -> Array:
    """Return d = 1 − S b / b of one channel, (M',); 0 where it is dark or no paint."""
    light = smooth @ (smooth.T @ row)
    lit = (light > DARK * light.mean()) & (row > 0)
    d = 1 - np.divide(light, row, out=np.ones_like(row), where=lit)
    return np.where(np.abs(d) < LARGEST_UNEVENNESS, d, 0)


def _fit_fields(terms: Array, rest: Array) -> tuple[Array, float, int]:
    """Return α of terms, (J, M''), the energy that they explain of the rest, their rank."""
    eigenvalues, V = np.linalg.eigh(terms @ terms.T)
    kept = eigenvalues > RESOLVED**2 * max(eigenvalues[-1], 1e-30)
    coordinates = (V.T @ (terms @ rest))[kept]
    shares = V[:, kept] @ (coordinates / eigenvalues[kept])
    return shares, float(np.sum(coordinates**2 / eigenvalues[kept])), int(kept.sum())


def moved(fields: Array, part: float, mask: Mask | None) -> Array:
    """Return fields, (J, M'), moved down by a part of the photograph, its end put before it."""
    if mask is None:
        return np.roll(fields, round(part * fields.shape[1]), axis=1)
    whole = np.zeros((len(fields), mask.size))
    whole[:, mask] = fields
    return np.roll(whole, round(part * mask.size), axis=1)[:, mask]
