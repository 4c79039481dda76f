"""Photographs in some of their pixels, and how well a scene's parameters explain them there.

Light that is known at single points of the wall is averaged over pixels.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from functools import cached_property
from typing import Any

import numpy as np
from scipy import sparse

from periscopy_sim.calibration.evidence import (
    CorrelatedNoise,
    Explanation,
    SharpExplanation,
    SharpImages,
    SmoothImages,
)
from periscopy_sim.calibration.moving_scene import Matrix, MovingScene
from periscopy_sim.errors import SceneError
from periscopy_sim.hidden import Size
from periscopy_sim.model.transport_operator import NOTHING_LEFT
from periscopy_sim.model.wall_gain import polynomials
from periscopy_sim.numerics import Array, Mask
from periscopy_sim.numerics.validation import InputError
from periscopy_sim.storage.pictures import MAJORITY, coverage


def footprints(pixels: Mask, across: int = 1, paint: Array | None = None) -> Any:
    """Return averages over M pixels of light in their middles, (M, M), sparse.

    The wall's `paint`, (M, 1), is in the light, and does not count where light is compared.

    The mean over a square of side h exceeds the light in its middle by h²/24 (∂²/∂x² + ∂²/∂y²), up
    to the fourth order; neighbours a pixel apart give these derivatives. For means
    of n x n points, n = `across`, the correction is n² times smaller.
    """
    index = np.full(pixels.shape, -1)
    index[pixels] = np.arange(np.count_nonzero(pixels))
    curvature = sparse.csr_array((index.max() + 1,) * 2, dtype=np.float32)
    for lines in (index, index.T):
        triples = np.stack([lines[:-2], lines[1:-1], lines[2:]])
        before, middle, after = triples[:, (triples >= 0).all(axis=0)]
        for other, weight in ((before, 1), (middle, -2), (after, 1)):
            weights = np.full(len(middle), weight / 24 / across**2, np.float32)
            curvature += sparse.csr_array((weights, (middle, other)), shape=curvature.shape)
    if paint is not None and len(paint) > 1:
        over, under = (sparse.diags_array(each[:, 0]) for each in (paint, 1 / paint))
        curvature = over @ curvature @ under
    return sparse.csr_array(curvature + sparse.eye_array(*curvature.shape), dtype=np.float32)


def averages(pixels: Mask, shape: Size, across: int = 1, paint: Array | None = None) -> Any:
    """Return averages over larger pixels of light in the middles of F pixels, (M, F), sparse.

    They are those of `averaged_photograph`, of which the mask leaves M: so a photograph and A are
    averaged alike, also where borders of the pixels, or of the mask, do not meet.
    """
    rows, columns = (coverage(*sizes) for sizes in zip(shape, pixels.shape, strict=True))
    parts = sparse.kron(sparse.csr_array(rows), sparse.csr_array(columns), format="csr")
    parts = parts[:, np.flatnonzero(pixels)]
    whole = parts.sum(axis=1)
    inside = np.flatnonzero(whole > MAJORITY)
    means = sparse.diags_array(1 / whole[inside]) @ parts[inside]
    return sparse.csr_array(means.astype(np.float32) @ footprints(pixels, across, paint))


DEGREE, SPREAD = 3, 0.15
"""Degree of the polynomial of the gain over the wall, and deviation of each coefficient. By 2 and
0.07, 2 and 0.15, or 3 and 0.07 the picture of a real ball, whose gain is steep, loses 1.5 dB."""


@dataclass(frozen=True, eq=False)
class Group:
    """K photographs of one kind of image: (K, M, C) light of C channels in the pixels used."""

    light: Array
    images: SmoothImages | SharpImages


@dataclass(frozen=True, eq=False)
class Candidate:
    """Photographs explained at a point."""

    point: Array  # (P + K,)
    explanations: tuple[Explanation, ...]  # of each group; () where there is no scene
    penalty: float  # −2 log of the prior's density, up to a constant

    @cached_property
    def cost(self) -> float:
        """−2 log evidence, up to a constant; infinite if the point is no scene."""
        return sum(each.cost for each in self.explanations) if self.explanations else np.inf

    def objective_at(self, temperature: float) -> float:
        """Twice the negative logarithm of the tempered posterior density, less a constant."""
        return self.cost / temperature + self.penalty


@dataclass(frozen=True, eq=False)
class Look(Candidate):
    """The objective and its derivatives at a point."""

    slope: Array  # (P + K,) derivatives of half the evidence
    prior_slope: Array  # (P + K,) derivatives of half the penalty
    information: Array  # (P + K, P + K) Fisher information of the photographs
    precision: Array  # (P + K,) of the prior
    temperature: float = 1.0  # κ, by which the evidence is divided
    motions: tuple[Array, ...] = ()  # (P + K, M, C) of each explanation, see `Explanation.motion`

    @property
    def objective(self) -> float:
        """The objective at the look's own temperature."""
        return self.objective_at(self.temperature)

    @property
    def downhill(self) -> Array:
        """(P + K,) derivatives of half the objective."""
        return self.slope / self.temperature + self.prior_slope

    def curvature(self, damping: float = 0.0) -> Array:
        """Return half the objective's, (P + K, P + K), a fraction of the information added."""
        information = self.information / self.temperature
        extra = damping * np.maximum(np.diag(information), 0)
        return np.asarray(information + np.diag(extra + self.precision))

    @property
    def predicted_gain(self) -> float:
        """Decrease of the objective that a whole Newton step promises."""
        return float(self.downhill @ np.linalg.solve(self.curvature(), self.downhill))


@dataclass(frozen=True, eq=False)
class ResolutionLevel:
    """Photographs in M large pixels, explained by P parameters of a scene and a gain over the wall.

    A point is (P + K,) numbers: the parameters, then the coefficients of the gain

        g = exp(Σ_k a_k p_k),   a_k ~ N(0, SPREAD²),   y_c = g (A f_c) + B b_c + n_c,

    p_k the polynomials of degree 1 to 3 over the wall. A lens, bounced light and the monitor's
    falloff make such a gain: without it, a scene moves until its shadows are as bright as the gain
    makes them.
    """

    scene: MovingScene  # seen in the pixels' middles; its errors are the prior's
    centers: Array  # (P,) means of the parameters before the photographs are looked at
    background: Array  # (M, r) orthonormal basis of the ambient light
    groups: tuple[Group, ...]  # the photographs, or their channels, by what is known of the images
    noise: CorrelatedNoise
    finer: tuple[MovingScene, Any] | None = None  # seen in more pixels, and `averages` over these
    photographs: int = 1  # how many there are

    @cached_property
    def terms(self) -> Array:
        """(K, M) p_k, between -1 and 1."""
        pixels = self.scene.pixels
        return polynomials(pixels.shape, 1, DEGREE)[:, pixels.ravel()]

    @cached_property
    def footprints(self) -> Any:
        """(M, M) sparse averages over the pixels of light in their middles."""
        return footprints(self.scene.pixels, self.scene.across, self.scene.scenario.paint)

    @cached_property
    def precision(self) -> Array:
        """(P + K,) of the prior."""
        return np.append(self.scene.errors**-2.0, np.full(len(self.terms), SPREAD**-2))

    @cached_property
    def center(self) -> Array:
        """(P + K,) the prior's mean: no gain."""
        return np.concatenate([self.centers, np.zeros(len(self.terms))])

    def values(self, point: Array) -> Array:
        """Return a point's parameters, (P,)."""
        return np.asarray(point[: len(self.centers)])

    def gain(self, point: Array) -> Matrix:
        """Return g, (M,), in single precision."""
        return np.exp(point[len(self.centers) :] @ self.terms).astype(np.float32)

    def penalty(self, point: Array) -> float:
        """Return twice the negative logarithm of the prior's density, less a constant."""
        return float(self.precision @ (point - self.center) ** 2)

    def with_edges(self, candidate: Candidate) -> ResolutionLevel:
        """Return a level whose image prior uses the edges of the estimated images."""
        groups, hidden = [], self.scene.scenario.hidden
        for group, explained in zip(self.groups, candidate.explanations, strict=True):
            if isinstance(explained, SharpExplanation):
                each = zip(group.light, explained.images, strict=True)
                groups += [Group(y[None], SmoothImages.like(hidden, f)) for y, f in each]
            else:
                groups.append(group)
        return replace(self, groups=tuple(groups))

    def with_misfit(self, candidate: Candidate) -> ResolutionLevel:
        """Return a level whose noise is like the residual of a candidate, explained `plainly`."""
        residual = np.hstack([each.residual for each in candidate.explanations])
        return replace(self, noise=self.noise.like(residual))

    def plainly(self, point: Array) -> Candidate:
        """Return the photographs explained at a point as if the noise were white."""
        white = replace(self.noise, excess=0 * self.noise.excess)
        return replace(self, noise=white).candidate(point)

    def candidate(self, point: Array) -> Candidate:
        """Return the photographs explained at a point, by nothing where it makes no scene."""
        scene, averages = self.finer or (self.scene, self.footprints)
        lights = [self.noise.whitened(np.hstack([*group.light])) for group in self.groups]
        try:
            A = averages @ scene.transport(self.values(point))
            bright = self.noise.whitened(self.gain(point)[:, None] * A)
            explained = tuple(
                group.images.explain(bright, self.background, light)
                for group, light in zip(self.groups, lights, strict=True)
            )
        except (SceneError, InputError):  # it makes no scene, or no shadow is in view
            return Candidate(point, (), self.penalty(point))
        return Candidate(point, explained, self.penalty(point))

    def look(self, candidate: Candidate, temperature: float = 1.0) -> Look:
        """Return the derivatives, too; a SceneError says that the point is no scene."""
        point = candidate.point
        A, changes = self.scene.linearized(self.values(point))
        S, gain = self.footprints, self.gain(point)[:, None]
        bright = gain * (S @ A)
        if not (explanations := candidate.explanations):
            raise SceneError(f"scene '{self.scene.scenario.path}': {NOTHING_LEFT}")
        volume = self.noise.whitened(np.sum([each.volume for each in explanations], axis=0))
        at_points = S.T @ (gain * volume)
        volumes = [float(np.vdot(at_points, dA)) for dA in changes]
        volumes += (self.terms @ np.einsum("mn,mn->m", volume, bright)).tolist()
        lights = np.hstack([each.lights for each in explanations]).astype(np.float32)
        by_gain = self.terms[:, :, None] * (bright @ lights)
        light = np.array([*(gain * (S @ (dA @ lights)) for dA in changes), *by_gain])
        light = np.moveaxis(self.noise.whitened(np.moveaxis(light, 0, 1)), 0, 1)
        borders = np.cumsum([each.lights.shape[1] for each in explanations])[:-1]
        parts = zip(explanations, np.split(light, borders, axis=2), strict=True)
        motions = tuple(each.motion(part) for each, part in parts)
        pairs = list(zip(explanations, motions, strict=True))
        slope = np.array(volumes)
        for each, motion in pairs:
            slope += each.pull(motion)
        free = np.concatenate([each.beyond_image(motion) for each, motion in pairs], axis=2)
        crossed = np.einsum("imc,jmc->ij", free, np.concatenate(motions, axis=2), optimize=True)
        return Look(
            point=point,
            explanations=explanations,
            penalty=candidate.penalty,
            slope=slope,
            prior_slope=self.precision * (point - self.center),
            information=(crossed + crossed.T) / 2,
            precision=self.precision,
            motions=motions,
            temperature=temperature,
        )
