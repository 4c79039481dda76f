"""Lines of ambient light across the wall that B lacks, estimated from the photograph itself.

Edges of lamps, doors and ceilings cast kinks that run down or across the whole wall, finer than
`wall_profiles`. A Gaussian prior describes them in each channel, in units of its misfit σ,

    y⊥ = A⊥ f + L o + n,   f ~ N(0, σ² τ K⁻¹),   o_k ~ N(0, σ² v/k⁴),   n ~ N(0, σ²),

with K that of `spectral_basis` and L the cosines of k half periods down the wall and across it,
range(B) projected out. τ and the v of both directions, which the channels share, and each channel's
σ maximize the likelihood of y⊥. The correction subtracts the expected light of the lines,
L E[o | y⊥]. Patterns of curvatures within a factor `BAND` share their mean, so that the likelihood
needs the products of L in each band only.

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

from periscopy_sim.model.fit import FirstImage, Fit, FittedPhotograph, camera_noise
from periscopy_sim.numerics import Array
from periscopy_sim.numerics.products import combine_rows

SHORTEST = 4
"""Shortest period of a cosine, in pixels: finer lines are the camera's."""

BAND = 2.0
"""Ratio of curvatures within which patterns share their mean."""

WIDE = 10.0
"""Standard deviation of o over that of noise, for k = 1, from which the search starts."""

SPAN = np.array([9.0, 15.0, 15.0])
"""How far the logarithms of τ and of the v may end from their starts."""

ENOUGH = 1e-6
"""Relative change of the log likelihood at which the search ends."""

TINY = 1e-30
"""Added to energies that may be zero, whose logarithms are needed."""


class AmbientLines:
    """The correction of lines of ambient light; see the module.

    It raises a ValueError if the rows and columns of photographs are unknown.
    """

    def __init__(self, fit: Fit) -> None:
        if fit.shape is None:
            raise ValueError("lines across the wall need photograph_shape, its rows and columns")
        self._fit, self._cosines = fit, [cosines(size) for size in fit.shape]
        self._direction = np.repeat([0, 1], [each.shape[1] for each in self._cosines])
        outside = fit.project_out(self._light(np.eye(len(self._direction))))
        shown = np.asarray(fit.lights @ outside.T, np.float64)
        rest = outside - shown.T @ fit.lights  # what images leave of lines
        signals = fit.curvatures / fit.curvatures.mean()  # ascending
        steps = np.floor(np.log(signals) / np.log(BAND))
        self._bands = np.flatnonzero(np.diff(steps, prepend=-np.inf))  # the first of each
        self._counts = np.diff(self._bands, append=len(signals))
        self._signals = np.add.reduceat(signals, self._bands) / self._counts
        self._shown, self._rest = np.split(shown, self._bands[1:]), rest.astype(np.float32)
        self._products = np.stack([rest @ rest.T, *(each.T @ each for each in self._shown)])

    def __call__(
        self,
        photograph: FittedPhotograph,
        first_image: FirstImage,  # noqa: ARG002
    ) -> tuple[FittedPhotograph, Mapping[str, Any]]:
        """Return a photograph without the light of its lines."""
        with threadpool_limits(1):  # products are small, and bits independent of the cores
            likelihood = self._likelihood(photograph)
            o = likelihood.expected() if likelihood.determined else None
            if o is None or not self._found(o, likelihood, photograph):
                return photograph, {"ambient_lines_found": False}
        planes = photograph.planes - photograph.evidence.level * self._light(o)
        return replace(photograph, planes=planes), {"ambient_lines_found": True}

    def _light(self, o: Array) -> Array:
        """Return L o on the wall of each row of o, (J, K), before the projection, (J, M')."""
        down, across = (o[:, self._direction == k] @ each.T for k, each in enumerate(self._cosines))
        light = (down[:, :, None] + across[:, None, :]).reshape(len(o), self._fit.A.shape[0])
        return np.ascontiguousarray(self._fit.on_wall(light.T).T)

    def _likelihood(self, photograph: FittedPhotograph) -> "Likelihood":
        """Return the likelihood of a photograph's lines, what images leave of it as first band."""
        fit, u = self._fit, self._fit.coordinates(photograph.evidence)
        rest = photograph.y - combine_rows(u.astype(np.float32), fit.lights)
        parts = zip(np.split(u, self._bands[1:], axis=1), self._shown, strict=True)
        common = [rest.astype(np.float32) @ self._rest.T, *(a @ b for a, b in parts)]
        energies = np.sum(rest**2, axis=1), *np.add.reduceat(u**2, self._bands, axis=1).T
        freedom = fit.pixels - len(fit.background) - len(fit.curvatures)
        return Likelihood(
            self._products,
            np.append(0, self._signals),
            np.append(freedom, self._counts),
            self._direction,
            np.stack(common, axis=1).astype(np.float64),
            np.stack(energies, axis=1),
        )

    def _found(self, o: Array, likelihood: "Likelihood", photograph: FittedPhotograph) -> bool:
        """Return whether lines o, (C, K), have more light than misfit and noise make."""
        fit, level = self._fit, photograph.evidence.level
        light = float(np.mean(fit.project_out(self._light(o)) ** 2))
        rest = float(np.mean(likelihood.rest(o)) / likelihood.counts[0])
        noise = camera_noise(fit.placed(photograph.planes.T))
        white = 0.0 if noise is None else min(rest, float(np.mean((noise / level) ** 2)))
        return light > rest - white + rest * len(self._direction) / fit.pixels


@dataclass(frozen=True, eq=False)
class Likelihood:
    """The likelihood of a photograph's lines: what it needs of each band of J patterns' light.

    The first band is what images leave, whose signal is 0.
    """

    products: Array  # (J, K, K) products of L
    signals: Array  # (J,) mean curvature, over that of all patterns
    counts: Array  # (J,) dimensions
    direction: Array  # (K,) 0 down the wall, 1 across
    common: Array  # (C, J, K) products of L with y⊥
    energies: Array  # (C, J) squared norms of y⊥

    @property
    def determined(self) -> bool:
        """Whether every channel has light, and more dimensions than there are lines."""
        lines = len(self.direction)
        return bool(lines and (self.energies[:, 0] > 0).all() and self.counts[0] > lines)

    def rest(self, o: Array) -> Array:
        """Return the energies that neither images nor lines o, (C, K), explain, (C,)."""
        known = np.sum(o * (o @ self.products[0] - 2 * self.common[:, 0]), axis=1)
        return np.asarray(self.energies[:, 0] + known)

    def expected(self) -> Array:
        """Return E[o | y⊥], (C, K), at the most likely variances."""
        signals = self.energies[:, 1:].sum(axis=1) / self.counts[1:].sum()
        ratio = np.mean(signals / self.energies[:, 0]) * self.counts[0]
        start = np.log([ratio + TINY, WIDE**2, WIDE**2])
        bounds = np.stack([start - SPAN, start + SPAN], axis=1)
        settings: Any = {"bounds": bounds, "options": {"ftol": ENOUGH}}
        best = optimize.minimize(lambda x: self.cost(x)[0], start, method="L-BFGS-B", **settings)
        return self.cost(best.x)[1]

    def cost(self, x: Array) -> tuple[float, Array]:
        """Return minus twice the log likelihood but for a constant, and E[o | y⊥].

        x has the logarithms of τ, the variance over σ² of a coordinate whose signal is 1, and of v
        down the wall and across it. The σ are the most likely ones.
        """
        τ, *v = np.exp(x)
        prior, D = np.array(v)[self.direction], τ * self.signals + 1
        root = np.sqrt(prior)
        precision = np.tensordot(1 / D, self.products, 1)
        factor = linalg.cho_factor(np.eye(len(root)) + root[:, None] * precision * root)
        data = (1 / D) @ self.common
        o = root * linalg.cho_solve(factor, (root * data).T).T
        energy = self.energies @ (1 / D) - np.sum(data * o, axis=1)
        value = self.counts.sum() * np.sum(np.log(energy))
        shared = self.counts @ np.log(D) + 2 * np.sum(np.log(np.diag(factor[0])))
        return float(value + len(o) * shared), np.asarray(o)


def cosines(size: int) -> Array:
    """Return cosines of k half periods over a side, (size, K), of amplitudes 1/k²."""
    k = np.arange(1, 2 * size // SHORTEST + 1)
    return np.asarray(np.cos(np.pi * k * (np.arange(size)[:, None] + 0.5) / size) / k**2)
