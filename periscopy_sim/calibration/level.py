"""The photograph at one resolution, and how well a scene's parameters explain it there."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from typing import Any

import numpy as np
from numpy.polynomial import legendre
from numpy.typing import NDArray

from periscopy_sim.calibration.evidence import Explanation, explain
from periscopy_sim.calibration.information import Curvature
from periscopy_sim.calibration.prior import Prior
from periscopy_sim.calibration.scene_matrices import SceneMatrices
from periscopy_sim.calibration.whitening import Whitening, WhiteNoise
from periscopy_sim.errors import PhotographError, SceneError
from periscopy_sim.model.ambient import background_basis, joined_basis
from periscopy_sim.photograph import blackened
from periscopy_sim.storage.pictures import area_average

Array = NDArray[np.float64]
Values = NDArray[np.float64]

MOST_PATCHES = 0.6
"""Hidden patches for each pixel used, at most: a long photograph keeps few rows."""

COVERED = 0.5
"""Fraction of a coarse pixel that the mask must leave; its mean is that of what is left."""

DEGREE, SPREAD = 2, 0.07
"""Of the gain over the wall: the degree of its polynomial, the deviation of each coefficient."""

LARGEST_GAIN = 0.5
"""By which a gain differs from 1 at most: beyond, it is no lens or bounced light."""


@dataclass(frozen=True, eq=False)
class Averaged:
    """A photograph and others of the same wall with the monitor off, averaged to coarse pixels.

    Attributes
    ----------
    used
        (rows, columns) coarse pixels that the mask leaves.
    light
        (M, 3) the photograph there.
    off
        The others, (M, 3) each.
    """

    used: NDArray[np.bool_]
    light: Array
    off: Sequence[Array] = ()

    @classmethod
    def of(
        cls,
        photograph: Array,
        off: Sequence[Array],
        mask: NDArray[np.bool_] | None,
        longest: int,
    ) -> Averaged:
        """Average photographs, (rows, columns, 3), to so many pixels along the longer side."""
        rows, columns = photograph.shape[:2]
        shape = fitted((rows, columns), longest)
        mask = np.ones((rows, columns), bool) if mask is None else mask
        coverage = area_average(mask[..., None], shape)
        used = coverage[..., 0] > COVERED + 1e-6  # ties are decided alike in mirror images

        def averaged(light: Array) -> Array:
            return np.asarray(area_average(blackened(light, mask), shape)[used] / coverage[used])

        return cls(used, averaged(photograph), [averaged(each) for each in off])

    @property
    def scale(self) -> float:
        """The photograph's root mean square."""
        return float(np.sqrt(np.mean(self.light**2))) if self.used.any() else 1.0

    def hidden_shape(self, hidden: tuple[int, int], longest: int) -> tuple[int, int]:
        """Return (R, C) of at most so many patches along a side, and fewer for few pixels."""
        shape = fitted(hidden, longest)
        fewer = np.sqrt(MOST_PATCHES * self.used.sum() / np.prod(shape))
        return shape if fewer >= 1 else fitted(hidden, max(1, int(fewer * max(shape))))

    def picture(self, values: Array, outside: float = 0.0) -> Array:
        """Return what used pixels have, (M, ...), as (rows, columns, ...)."""
        laid = np.full((*self.used.shape, *values.shape[1:]), outside)
        laid[self.used] = values
        return laid


@dataclass(frozen=True, eq=False)
class ResolutionLevel:
    """A photograph at one resolution, explained by a scene's P parameters and a gain over the wall.

    A point is (P + K,) numbers: the parameters, then the coefficients of the gain

        g = 1 + Σ_k a_k p_k,   a_k ~ N(0, SPREAD²),   y_c = g (A f_c) + B b_c + n_c,

    p_k the polynomials of degree ≤ 2 over the wall, without the constant. A lens, bounced light and
    the monitor's falloff make such a gain: without it, a scene moves until its shadows are as
    bright as the gain makes them.

    Attributes
    ----------
    averaged, matrices, prior
        The photograph, the scene and the prior of its parameters.
    background
        (M, r) orthonormal basis of the ambient light.
    seed
        Of the white noise that residuals are compared with.
    whitening, noise, overdispersion
        The filter of the errors; what makes one of a residual; κ, see `evidence`.
    """

    averaged: Averaged
    matrices: SceneMatrices
    prior: Prior
    background: Array
    seed: int = 0
    whitening: Whitening | None = None
    noise: WhiteNoise | None = None
    overdispersion: float = 1.0

    @classmethod
    def of(
        cls,
        averaged: Averaged,
        matrices: SceneMatrices,
        prior: Prior,
        values: Values,
        seed: int = 0,
    ) -> ResolutionLevel:
        """Return the level with the ambient light as seen at some values.

        After a camera's move by a centimetre or 2 degrees at most 3e-7 of the light lies outside of
        what the point lights span there. A PhotographError says that too few pixels are used.
        """
        B = matrices.point_lights(values)[averaged.used.ravel()]
        basis = joined_basis(background_basis(B), np.hstack([B[:, :0], *averaged.off]))
        if len(basis) <= 2 * basis.shape[1]:
            raise PhotographError(
                f"{len(basis)} coarse pixels are used, too few beside {basis.shape[1]} kinds of "
                "ambient light; give a larger photograph, or mask less of it"
            )
        return cls(averaged, matrices, prior, basis, seed)

    @cached_property
    def terms(self) -> Array:
        """(K, M) p_k, between -1 and 1."""
        axes = (np.linspace(-1, 1, size) for size in self.averaged.used.shape)
        y, x = (legendre.legvander(each, DEGREE) for each in axes)
        orders = [(j, k) for j in range(DEGREE + 1) for k in range(DEGREE + 1 - j) if j + k]
        fields = np.array([np.outer(y[:, j], x[:, k]) for j, k in orders])
        return np.asarray(fields[:, self.averaged.used])

    def start(self, values: Values) -> Array:
        """Return the point of some parameters, (P,), with no gain."""
        return np.concatenate([values, np.zeros(len(self.terms))])

    def values(self, point: Array) -> Values:
        """Return a point's parameters, (P,)."""
        return np.asarray(point[: len(self.matrices.names)])

    def gain(self, point: Array) -> Array:
        """Return g, (M,)."""
        return np.asarray(1 + point[len(self.matrices.names) :] @ self.terms)

    def penalty(self, point: Array) -> float:
        """Return twice the negative logarithm of the prior's density, less a constant."""
        gain = point[len(self.matrices.names) :] / SPREAD
        return self.prior.penalty(self.values(point)) + float(np.sum(gain**2))

    def is_physical(self, point: Array) -> bool:
        """Return whether there is a scene, and a gain, at a point."""
        small = bool(np.abs(self.gain(point) - 1).max(initial=0) < LARGEST_GAIN)
        return small and self.matrices.is_physical(self.values(point))

    @property
    def white(self) -> ResolutionLevel:
        """The same level, all errors taken for white noise."""
        return replace(self, whitening=None, overdispersion=1.0)

    @property
    def discrepancy(self) -> float:
        """How much stronger errors are than white noise at the scale where they are strongest."""
        return 1.0 if self.whitening is None else self.whitening.discrepancy

    def matrix(self, point: Array) -> NDArray[Any]:
        """Return A at the pixels used, (M, N), without the gain; see `SceneMatrices.matrix`."""
        return np.asarray(self.matrices.matrix(self.values(point))[self.averaged.used.ravel()])

    def explain(self, point: Array, A: NDArray[Any] | None = None) -> Explanation:
        """Explain the photograph at a point, where A may be known; the penalty is included.

        A SceneError says that the point is not physical.
        """
        gain = self.gain(point)
        if np.abs(gain - 1).max(initial=0) >= LARGEST_GAIN:
            raise SceneError("the gain over the wall is too large")
        A = self.matrix(point) if A is None else A
        light = self.averaged.light
        bright = gain.astype(A.dtype)[:, None] * A
        shape, κ = self.matrices.hidden_shape, self.overdispersion
        found = explain(bright, self.background, light, shape, self.whitening, κ)
        return replace(found, evidence=found.evidence + self.penalty(point))

    def judge(self, point: Array) -> Explanation:
        """Explain the photograph as `explain` does, by the spectrum of the point's own residual.

        By the spectrum of a wrong place, that place would look better than the truth.
        """
        A = self.matrix(point)
        if self.noise is None:
            return self.explain(point, A)
        whitening = self.noise.whitening(self.white.explain(point, A))
        return replace(self, whitening=whitening).explain(point, A)

    def judgement(self, point: Array) -> float:
        """Return the evidence of `judge`, infinite where the point is not physical."""
        try:
            return self.judge(point).evidence
        except SceneError:
            return np.inf

    def comparing(self, point: Array) -> ResolutionLevel:
        """Return the level, to compare residuals with white noise as left at a point."""
        white = self.white
        noise = WhiteNoise.of(white.explain(point), self.averaged.used, self.seed)
        return replace(self, noise=noise)

    def look(self, point: Array) -> tuple[ResolutionLevel, Explanation, Curvature]:
        """Return the level for the residual of a point, and what is seen there by it."""
        used = self.averaged.used
        A, changes = self.matrices.linearized(self.values(point))
        if not used.all():
            A, changes = A[used.ravel()], changes[:, :, used.ravel()]
        white = self.white
        found = white.explain(point, A)
        rough = white.curvature(point, found, A, changes)
        noise = WhiteNoise.of(found, used, self.seed, rough.absorb)
        level = replace(white, noise=noise, whitening=noise.whitening(found))
        found = level.explain(point, A)
        about = level.curvature(point, found, A, changes)
        errors = about.absorb(found.residual / found.deviations)
        κ = about.overdispersion(about.block_scores(errors, used))
        penalty = self.penalty(point)
        evidence = (found.evidence - penalty) / κ + penalty
        found = replace(found, evidence=evidence, darkness=found.darkness / κ, overdispersion=κ)
        return replace(level, overdispersion=κ), found, about.tempered(κ)

    def curvature(
        self, point: Array, found: Explanation, A: NDArray[Any], changes: NDArray[Any]
    ) -> Curvature:
        """Return what the photograph tells near a point, as explained, by A and its derivatives.

        A is (M, N), the derivatives (S, P, M, N) of S sets of rays.
        """
        gain, images = self.gain(point), found.images.astype(A.dtype)
        volume = gain.astype(A.dtype)[:, None] * found.volume
        by_gain = self.terms[:, :, None] * (A @ images)
        volumes_by_gain = self.terms @ np.einsum("mn,mn->m", found.volume, A)
        sets = []
        for by_parameter in changes:
            lit = [gain[:, None] * (change @ images) for change in by_parameter]
            motions = np.array([found.motion(light) for light in (*lit, *by_gain)])
            volumes = [*(float(np.vdot(volume, dA)) for dA in by_parameter), *volumes_by_gain]
            slopes = [found.slope(*pair) for pair in zip(motions, volumes, strict=True)]
            sets.append((np.array(slopes), motions, found.beyond_image(motions)))
        crossed = np.einsum("imc,jmc->ij", sets[0][2], sets[-1][1])
        coefficients = point[len(self.matrices.names) :]
        ruled = np.append(self.prior.slope(self.values(point)), coefficients / SPREAD**2)
        return Curvature(
            slope=np.mean([slopes for slopes, *_ in sets], axis=0) + ruled,
            information=(crossed + crossed.T) / 2,
            beyond=np.mean([beyond for *_, beyond in sets], axis=0),
            precision=np.append(self.prior.precision, np.full(len(coefficients), SPREAD**-2)),
            ruled=ruled,
        )


def fitted(size: tuple[int, int], longest: int) -> tuple[int, int]:
    """Return (rows, columns) shrunk in proportion, the longer to at most `longest`."""
    factor = min(1.0, longest / max(size))
    rows, columns = (max(1, round(factor * n)) for n in size)
    return rows, columns
