"""A scene as the noise-aware method is fitted to it: once, for every photograph."""

from __future__ import annotations

from copy import copy
from dataclasses import replace
from functools import cached_property
from typing import Self

import numpy as np
from numpy.typing import NDArray

from periscopy_sim.numerics.products import (
    combine_rows,
    rejected,
    subtract_combinations,
    times_rows,
)
from periscopy_sim.reconstruction.ambient_method import AmbientMethod
from periscopy_sim.reconstruction.large_scale.transport_operator import TransportOperator
from periscopy_sim.reconstruction.method import Image
from periscopy_sim.reconstruction.noise_aware.evidence import (
    Evidence,
    noise_of,
    noise_to_signal,
    root_mean_squares,
)
from periscopy_sim.reconstruction.noise_aware.nuisance.ambient_prior import (
    AmbientEstimate,
    AmbientPrior,
)
from periscopy_sim.reconstruction.noise_aware.nuisance.noise_spectrum import NoiseSpectrum
from periscopy_sim.reconstruction.noise_aware.nuisance.wall_gain import (
    DEGREE,
    WallGain,
    polynomials,
)
from periscopy_sim.reconstruction.noise_aware.solution import NoiseAwareReconstruction
from periscopy_sim.reconstruction.noise_aware.solver.spectral_basis import SpectralBasis
from periscopy_sim.reconstruction.residual.overdispersion import overdispersion_of
from periscopy_sim.reconstruction.uncertain_scene.displacement import Displacement, estimate
from periscopy_sim.reconstruction.uncertain_scene.uncertain_transport import UncertainTransport

Array = NDArray[np.float64]

SEEN = 1e-12
"""Curvatures below this part of the largest are patterns that the wall does not show."""

STRONG = 1e-8
"""Curvatures above this part of the largest are patterns that explain more than rounding does."""

MARGIN = 1.3
"""Times larger than by the linear theory that errors of an uncertain scene are told to be, as after
a calibration: valleys are curved, and what moves the light is taken of an image that errs."""


class FittedScene(AmbientMethod[np.float64]):
    """What one scene's A and B make of photographs, before an image is looked for.

    Parameters and errors are those of `NoiseAware`.
    """

    uncertain: UncertainTransport | None

    def _fit(self, used: Array, Q: Array, wall_gain: bool | None, ambient_prior: bool) -> None:
        """Fit to A of the pixels used, (M', N), and an orthonormal basis of range(B), (M', r)."""
        self._background = np.ascontiguousarray(Q.T)
        self._transport = np.ascontiguousarray(used.T, np.float32)
        C = Q.T @ used
        gram = used.T @ used - C.T @ C
        energy = float(np.trace(gram))
        if not energy > 1e-12 * float(np.vdot(used, used)):
            raise ValueError("A with the backgrounds projected out is zero: B explains all of it")
        self.norm = np.sqrt(energy)
        # Scaled by the mean energy of a patch, f is near 1 in units of y over that root.
        self._unit = np.sqrt(energy / len(gram))
        self._gram = gram
        self._basis = SpectralBasis(gram / self._unit**2, self.hidden_shape)
        curvatures = self._basis.curvatures  # they ascend
        self._seen = slice(int((curvatures <= SEEN * curvatures[-1]).sum()), None)
        self._curvatures = curvatures[self._seen]
        self._ambient_prior = self._fitted_prior() if ambient_prior else None
        self._wall_gain = self._fitted_gain(wall_gain)

    def displaced(self, uncertain: UncertainTransport, u: Array) -> Self:
        """Return the method fitted to the scene whose uncertain parameters are at u, (K,).

        A ValueError says that there is no such scene.
        """
        there = copy(self)
        there.uncertain = None
        there.__dict__.pop("_spectrum", None)
        if uncertain.render is not None:
            used = self.observation.used_transport(uncertain.render(uncertain.at(u)))
        else:
            used = self._transport.T + uncertain.change(u, self.observation.mask)
        searched = self._wall_gain is not None, self._ambient_prior is not None
        there._fit(used, self._background.T, *searched)
        return there

    def left_of(self, photograph: Image) -> Array:
        """Return what no hidden image and no ambient light explain of a photograph, (3, M')."""
        return self._unexplained(self._rejected(np.asarray(photograph)[None])[0][0])

    def displacement(
        self,
        uncertain: UncertainTransport,
        left: Array,
        found: NoiseAwareReconstruction,
        here: Array,
    ) -> Displacement:
        """Return where the scene is by a photograph, what is `left_of` it, and its image.

        The method is fitted to the scene at `here`, (K,); see `uncertain_scene.displacement`.
        """
        shape, mask = self.observation.rows_and_columns, self.observation.mask
        assert shape is not None
        σ = found.noise[:, None]
        f = found.image.reshape(-1, 3)
        signal = combine_rows(np.ascontiguousarray(f.T, np.float32), self._transport) / σ
        terms = polynomials(shape, 1, DEGREE)
        used = np.ones(shape, bool) if mask is None else mask.reshape(shape)
        κ = MARGIN**2 * overdispersion_of(
            (left / σ).T,
            lambda errors: self._unexplained(np.ascontiguousarray(errors.T)).T,
            used,
        )
        return estimate(
            left / σ,
            self._moved_light(uncertain, found) / σ,
            terms[:, None, used.ravel()] * signal,
            self._unexplained,
            κ,
            here,
            exact=uncertain.render is not None,
        )

    def geometry_response(self, found: NoiseAwareReconstruction) -> Array | None:
        """Return A⊥ᵀ D f̂ L, (K, 3, N), L Lᵀ the covariance of u that a photograph left.

        Of independent standard errors of the scene, what they do to the light that images explain.
        None where the scene is taken for right.
        """
        if found.scene is None:
            return None
        light = self._moved_light(found.scene.uncertain, found).mean(axis=0)
        values, vectors = np.linalg.eigh(found.scene.displacement.covariance)
        L = vectors * np.sqrt(np.maximum(values, 0))
        rows = np.tensordot(L.T, light, 1).reshape(-1, light.shape[-1])
        rows = np.ascontiguousarray(self._rejected_rows(rows), np.float32)
        return times_rows(rows, self._transport).reshape(*light.shape[:2], -1).astype(np.float64)

    def _error_response(self, found: NoiseAwareReconstruction) -> Array | None:
        """Return what errors of scene and ambient light do, for `standard_errors`; None without."""
        responses = [self.geometry_response(found)]
        if self._ambient_prior is not None and found.ambient is not None:
            seen = self._transport, found.ambient, found.noise
            responses.append(self._ambient_prior.response(*seen))
        known = [each for each in responses if each is not None]
        return np.concatenate(known) if known else None

    def _moved_light(self, uncertain: UncertainTransport, found: NoiseAwareReconstruction) -> Array:
        """Return g D f̂, (1 or 2, K, 3, M'), of the pixels used."""
        mask = self.observation.mask
        gain = found.gain.ravel() if mask is None else found.gain.ravel()[mask.ravel()]
        return uncertain.lights(found.image.reshape(-1, 3), mask) * gain

    def evidence(self, photographs: Image, evenness: Array | None = None) -> list[Evidence]:
        """Return what the objective needs of each photograph, Aᵀ applied to all in one product.

        They are (K, rows, columns, 3) or (K, M, 3), linear, each in any unit. All are brought to an
        even wall by one `evenness`, or each by its own.
        """
        planes, shares, _ = self._rejected(photographs, evenness)
        return self._evidence(planes, shares)

    def _rejected(
        self, photographs: Image, evenness: Array | None = None
    ) -> tuple[Array, Array, Array]:
        """Return photographs, range(B) projected out, (K, 3, M'), and what is left of them.

        That is the share left, (K,), and the mean of each channel before, (K, 3).
        """
        planes = self._planes(photographs, evenness)
        means = planes.mean(axis=2)
        whole = root_mean_squares(planes)
        y = planes.reshape(-1, planes.shape[-1])  # a row for each channel of each photograph
        subtract_combinations(y, times_rows(y, self._background), self._background)
        return planes, root_mean_squares(planes) / np.where(whole > 0, whole, 1), means

    def _evidence(self, planes: Array, shares: Array) -> list[Evidence]:
        """Return the evidence of (K, 3, M') planes, and divide them by their levels, in place."""
        levels = root_mean_squares(planes)
        levels[levels == 0] = 1
        planes /= levels[:, None, None]  # single precision needs numbers near 1
        y = planes.reshape(-1, planes.shape[-1]).astype(np.float32)
        h = times_rows(y, self._transport) * np.float32(1 / self._unit)
        products = times_rows(h, self._basis.rows).astype(np.float64)
        coefficients = products.reshape(*planes.shape[:2], -1)
        rank, seen = len(self._background), coefficients[..., self._seen]
        noises = noise_of(planes, seen, self._curvatures, rank)
        ratios = noise_to_signal(noises, y.shape[1], rank, len(self._curvatures))
        numbers = (each.tolist() for each in (levels, shares, ratios))
        return [Evidence(*each) for each in zip(coefficients, noises, *numbers, strict=True)]

    def _without(self, evidence: Evidence, y: Array, light: Array | None) -> tuple[Evidence, Array]:
        """Return evidence of y, (3, M'), less some light, and what is left of y.

        y is of the evidence's level, the light of the photograph's unit, what is left of the level
        of its own evidence.
        """
        if light is None:
            return evidence, y
        planes = (y - light / evidence.level)[None]
        (rest,) = self._evidence(planes, np.array([evidence.share]))
        level, share = evidence.level * rest.level, evidence.share * rest.level
        return replace(rest, level=level, share=share), planes[0]

    def _ambient_strength(
        self, evidence: Evidence, y: Array, means: Array
    ) -> AmbientEstimate | None:
        """Return how much ambient light beyond range(B) the y of an evidence shows, if any."""
        if self._ambient_prior is None:
            return None
        seen = y, self._coordinates(evidence), evidence.noise
        return self._ambient_prior.estimate(*seen, means / evidence.level)

    def _coordinates(self, evidence: Evidence) -> Array:
        """Return the coordinates along the A⊥ W_k/√λ_k of the y of an evidence, (3, N')."""
        return np.asarray(evidence.coefficients[:, self._seen] / np.sqrt(self._curvatures))

    def _light_of(self, image: Image) -> Array:
        """Return A⊥ f, (3, M'), of an image, (R, C, 3)."""
        f = np.ascontiguousarray(image.reshape(-1, 3).T, np.float32)
        return np.asarray(self._rejected_rows(combine_rows(f, self._transport)), np.float64)

    def projected_transport(self) -> TransportOperator:
        """Return A⊥ of the pixels used; see `StillMethod`."""
        return TransportOperator(np.ascontiguousarray(self._transport.T), self._background.T)

    def _unexplained(self, rows: Array) -> Array:
        left = self._rejected_rows(rows).astype(np.float32)
        shown = times_rows(times_rows(left, self._transport), self._basis.rows)
        # Weaker patterns explain nothing beyond single precision.
        least = STRONG * self._basis.curvatures[-1]
        shown[:, self._basis.curvatures <= least] = 0
        curvatures = np.maximum(self._basis.curvatures, least)  # where it is 0, too
        coefficients = (shown / (self._unit**2 * curvatures)).astype(np.float32)
        images = combine_rows(coefficients, self._basis.rows)
        return left - self._rejected_rows(combine_rows(images, self._transport))

    def _rejected_rows(self, rows: Image) -> Image:
        """Return (J, M') rows, range(B) projected out."""
        return rejected(rows, self._background)

    @cached_property
    def _spectrum(self) -> NoiseSpectrum:
        """How noise of each frequency shows in the patterns."""

        def shown(rows: Array) -> Array:
            products = times_rows(self._rejected_rows(rows).astype(np.float32), self._transport)
            coefficients = times_rows(products / np.float32(self._unit), self._basis.rows)
            return np.asarray(coefficients[:, self._seen] / np.sqrt(self._curvatures))

        shape = self.observation.rows_and_columns
        assert shape is not None
        return NoiseSpectrum(shape, self.observation.mask, self._unexplained, shown)

    def _shown_of(self, images: Image) -> Array:
        """Return the coefficients of the light of (3, N) images, of the patterns seen, (3, N')."""
        # Aᵀ A is symmetric.
        products = times_rows(np.ascontiguousarray(images, np.float64), self._gram)
        shown = times_rows(products.astype(np.float32), self._basis.rows)
        return np.asarray(shown[:, self._seen], np.float64)

    def _fitted_prior(self) -> AmbientPrior | None:
        """Return what finds ambient light beyond range(B), where there is a B alone."""
        shape = self.observation.rows_and_columns
        if shape is None or not len(self._background) or self.observation.backgrounds:
            return None
        patterns, curvatures = self._basis.rows[self._seen], self._curvatures * self._unit**2
        seen = self._transport, self._background, patterns, curvatures
        return AmbientPrior(*seen, shape, self.observation.mask)

    def _fitted_gain(self, wanted: bool | None) -> WallGain | None:
        """Return what finds gains, if wanted."""
        shape = self.observation.rows_and_columns
        self._wall_shape = shape or (self.observation.pixels,)
        if shape is None and wanted:
            raise ValueError(
                "wall_gain needs the rows and columns of photographs: give photograph_shape"
            )
        if shape is None or wanted is False:
            return None
        return WallGain(
            self._transport,
            self._background,
            self._basis.rows[self._seen],
            self._curvatures * self._unit**2,
            shape,
            self.observation.mask,
            None if self._ambient_prior is None else self._ambient_prior.compared,
        )
