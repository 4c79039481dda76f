"""Lines of ambient light across the wall that B lacks, estimated from the photograph itself.

Edges of lamps, doors and ceilings cast kinks that run down or across the whole wall, finer than
`wall_profiles`. In each channel a Gaussian prior describes them,

    y⊥ = A⊥ f + L o + n,   f ~ N(0, τ K⁻¹),   o_k ~ N(0, v/k⁴),   n ~ N(0, σ²),

with K that of `spectral_basis` and L the cosines of k half periods down the wall and across it,
range(B) projected out. The τ, σ and the v of both directions maximize the likelihood of y⊥. The
correction subtracts the expected light of the lines, L E[o | y⊥].

Are there lines at all? Errors of the scene make light that looks like lines, too: on real
photographs without ambient light less than half of the misfit, the root mean square that neither
images nor lines nor the camera's noise explain. So lines count where their light exceeds the misfit
and what noise alone makes of so many terms. `docs/results/corrections.md` has the measurements.
"""

from collections.abc import Mapping
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from scipy import linalg, optimize
from threadpoolctl import threadpool_limits

from periscopy_sim.model.correction import FirstImage
from periscopy_sim.model.fit import Fit, FittedPhotograph
from periscopy_sim.model.noise import camera_noise
from periscopy_sim.numerics import Array
from periscopy_sim.numerics.products import combine_rows

SHORTEST = 4
"""Shortest period of a cosine, in pixels: finer lines are the camera's."""

WIDE = 10.0
"""Standard deviation of o over that of noise, for k = 1, from which the search starts."""

SPAN = np.array([9.0, 9.0, 15.0, 15.0])
"""How far the logarithms of τ, σ² and of the v may end from their starts."""

ENOUGH = 1e-6
"""Relative change of the log likelihood at which the search ends: 0.1 of it or so."""

TINY = 1e-30
"""Added to energies that may be zero, whose logarithms are needed."""


class AmbientLines:
    """The correction of lines of ambient light; see the module.

    It raises a ValueError if the rows and columns of photographs are unknown.
    """

    def __init__(self, fit: Fit) -> None:
        if fit.shape is None:
            raise ValueError("lines across the wall need photograph_shape, its rows and columns")
        rows, columns = fit.shape
        down, across = cosines(rows), cosines(columns)
        light = np.hstack([np.repeat(down, columns, axis=0), np.tile(across, (rows, 1))])
        self._fit, self._lines = fit, np.ascontiguousarray(fit.on_wall(light).T)
        outside = fit.project_out(self._lines)
        self._direction = np.repeat([0, 1], [down.shape[1], across.shape[1]])
        self._shown = np.asarray(fit.lights @ outside.T, np.float64)
        self._rest = outside - self._shown.T @ fit.lights  # what images leave of lines
        self._products = self._rest @ self._rest.T

    def __call__(
        self,
        photograph: FittedPhotograph,
        first_image: FirstImage,  # noqa: ARG002
    ) -> tuple[FittedPhotograph, Mapping[str, Any]]:
        """Return a photograph without the light of its lines."""
        channels, count = self._channels(photograph), len(self._lines)
        if not (count and all(each.energy > 0 and each.freedom > count for each in channels)):
            return photograph, {"ambient_lines_found": False}
        with threadpool_limits(1):  # products are small, and bits independent of the cores
            o = np.array([each.expected() for each in channels])
        if not self._found(o, channels, photograph):
            return photograph, {"ambient_lines_found": False}
        planes = photograph.planes - photograph.evidence.level * (o @ self._lines)
        return replace(photograph, planes=planes), {"ambient_lines_found": True}

    def _channels(self, photograph: FittedPhotograph) -> list["Channel"]:
        fit, coordinates = self._fit, self._fit.coordinates(photograph.evidence)
        left = photograph.y - combine_rows(coordinates.astype(np.float32), fit.lights)
        known = self._shown, self._products, fit.curvatures / fit.curvatures.mean()
        freedom = fit.pixels - len(fit.background) - len(fit.curvatures)
        return [
            Channel(*known, self._direction, u, self._rest @ r, float(r @ r), freedom)
            for u, r in zip(coordinates, left, strict=True)
        ]

    def _found(self, o: Array, channels: list["Channel"], photograph: FittedPhotograph) -> bool:
        """Return whether lines o, (C, K), have more light than misfit and noise make."""
        fit, level = self._fit, photograph.evidence.level
        light = float(np.mean(fit.project_out(o @ self._lines) ** 2))
        rest = float(
            np.mean([c.rest(each) / c.freedom for c, each in zip(channels, o, strict=True)])
        )
        noise = camera_noise(fit.placed(photograph.planes.T))
        white = 0.0 if noise is None else min(rest, float(np.mean((noise / level) ** 2)))
        return light > rest - white + rest * len(self._lines) / fit.pixels


@dataclass(frozen=True, eq=False)
class Channel:
    """One channel of a photograph, y⊥, and the likelihood of its lines."""

    shown: Array  # (N', K) L's coordinates along the patterns' light
    products: Array  # (K, K) products of what images leave of L
    signals: Array  # (N',) the patterns' curvatures over their mean
    direction: Array  # (K,) 0 down the wall, 1 across
    coordinates: Array  # (N',) y⊥'s coordinates along the patterns' light
    common: Array  # (K,) products of L with what images leave of y⊥
    energy: float  # squared norm of what images leave of y⊥
    freedom: int  # its dimensions

    def rest(self, o: Array) -> float:
        """Return the energy that neither images nor lines o explain."""
        return float(self.energy - 2 * self.common @ o + o @ self.products @ o)

    def expected(self) -> Array:
        """Return E[o | y⊥], (K,), at the most likely variances."""
        variance = self.energy / self.freedom
        widest = WIDE**2 * variance
        signal = float(np.mean(self.coordinates**2)) + TINY
        start = np.log([signal, variance, widest, widest])
        best = optimize.minimize(
            lambda x: self.cost(x)[:2],
            start,
            jac=True,
            method="L-BFGS-B",
            bounds=np.stack([start - SPAN, start + SPAN], axis=1),
            options={"ftol": ENOUGH},
        )
        return self.cost(best.x)[2]

    def cost(self, x: Array) -> tuple[float, Array, Array]:
        """Return minus twice the log likelihood but for a constant, its slopes, and E[o | y⊥].

        x has the logarithms of τ, σ² and of v down the wall and across it, where τ is the variance
        of a coordinate whose signal is 1.
        """
        τ, variance, *v = np.exp(x)
        prior, D = np.array(v)[self.direction], τ * self.signals + variance
        scaled, root = self.shown / D[:, None], np.sqrt(prior)
        precision = self.shown.T @ scaled + self.products / variance
        factor = linalg.cho_factor(np.eye(len(root)) + root[:, None] * precision * root)
        inverse = linalg.cho_solve(factor, np.eye(len(root)))
        data = scaled.T @ self.coordinates + self.common / variance
        o = root * (inverse @ (root * data))
        Σ = root[:, None] * inverse * root
        e, rest = self.coordinates - self.shown @ o, self.rest(o)
        value = np.sum(np.log(D) + e**2 / D) + self.freedom * x[1] + rest / variance
        value += 2 * np.sum(np.log(np.diag(factor[0]))) + np.sum(o**2 / prior)
        by_D = 1 / D - np.sum((scaled @ Σ) * scaled, axis=1) - (e / D) ** 2
        by_variance = self.freedom - (np.sum(Σ * self.products) + rest) / variance
        by_prior = 1 - np.diag(inverse) - o**2 / prior
        slopes = [τ * by_D @ self.signals, by_variance + variance * by_D.sum()]
        slopes += [by_prior[self.direction == k].sum() for k in (0, 1)]
        return float(value), np.array(slopes), o


def cosines(size: int) -> Array:
    """Return cosines of k half periods over a side, (size, K), of amplitudes 1/k²."""
    k = np.arange(1, 2 * size // SHORTEST + 1)
    return np.asarray(np.cos(np.pi * k * (np.arange(size)[:, None] + 0.5) / size) / k**2)
