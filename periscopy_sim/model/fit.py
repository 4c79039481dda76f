"""A scene fitted to the pixels that photographs use: once, for every photograph.

    y⊥ = A⊥ f + n,   A⊥ = A − Q QᵀA,   y⊥ = y − Q Qᵀ y

Q is an orthonormal basis of all ambient light, so that least squares of y⊥ are those of y on
[A, B] with the ambient light fitted freely: the very information that the paper's P keeps.
"""

from dataclasses import dataclass
from functools import cached_property

import numpy as np

from periscopy_sim.model.ambient import (
    RANK_TOLERANCE,
    ROUNDING,
    background_basis,
    joined_basis,
    wall_profiles,
)
from periscopy_sim.model.noise import residual_noise
from periscopy_sim.model.observation import Observation
from periscopy_sim.model.spectral_basis import SpectralBasis
from periscopy_sim.model.transport_operator import NOTHING_LEFT, TransportOperator
from periscopy_sim.numerics import Array, Image
from periscopy_sim.numerics.precision import precision_of
from periscopy_sim.numerics.products import project_out, times_rows
from periscopy_sim.numerics.validation import InputError

PRECISION = 3e-5
"""Relative precision of A by areas (1.5e-5 for the plate); A by rays has less."""

LARGEST_NOISE_RATIO = 30
"""Largest ratio of the noises of two channels; it bounds a black channel's noise from below."""


@dataclass(frozen=True, eq=False)
class Evidence:
    """The information on the hidden image in one photograph.

    The coefficients are those of y⊥ over its level and A⊥ over a patch's root mean square energy.
    """

    coefficients: Array  # (3, N) WᵀA⊥ᵀ y⊥ in the camera's channels
    noise: Array  # (3,) standard deviation of the noise in y⊥, over the level
    level: float  # root mean square of y⊥
    noise_to_signal: float  # energy of the noise in y⊥ over that of the signal

    @property
    def mean_noise(self) -> float:
        """The σ that λ is counted in: the mean over the channels."""
        return float(self.noise.mean())


@dataclass(frozen=True, eq=False)
class FittedPhotograph:
    """A photograph in the pixels used, as one scene explains it."""

    planes: Array  # (3, M') each channel over the wall's colour
    fit: "Fit"

    @property
    def evidence(self) -> Evidence:
        """The photograph's information on its hidden image."""
        return self._projected[0]

    @property
    def y(self) -> Array:
        """(3, M') y⊥ over its level."""
        return self._projected[1]

    @cached_property
    def _projected(self) -> tuple[Evidence, Array]:
        (evidence,), (y,) = self.fit.evidence(self.planes[None])
        return evidence, y


class Fit:
    """One scene's A and ambient light, in the pixels that photographs use.

    Parameters
    ----------
    observation
        The pixels used, and photographs with the monitor off.
    A
        (M, N) light transport matrix.
    B
        (M, L) prototype backgrounds; None for none.
    rank_tolerance
        Relative tolerance on B's singular values, see `background_basis`.
    profiles
        Whether `wall_profiles` join the ambient light, where there is a B and the photograph's rows
        and columns are known.

    Attributes
    ----------
    transport, background
        (N, M') Aᵀ in single precision and (r, M') Qᵀ, of the M' pixels used.
    smooth_rank
        Number of the first rows of `background`, which need no background photograph.
    gram, norm, unit
        (N, N) A⊥ᵀA⊥, ‖A⊥‖_F, and ‖A⊥‖_F/√N, over which f is near 1 in units of y⊥.
    patterns
        The spectral basis of A⊥ᵀA⊥ over the square of the unit.
    least_curvature
        Fraction of the largest curvature up to which a curvature counts as rounding of A.
    visible, curvatures
        Slice of the patterns that the wall shows, and their curvatures, (N',).

    Raises
    ------
    ValueError
        If A or B is not finite where it is used, or B explains all of A.
    """

    def __init__(
        self,
        observation: Observation,
        A: Image,
        B: Image | None,
        rank_tolerance: float,
        *,
        profiles: bool = False,
    ) -> None:
        self.observation = observation
        used = observation.used_transport(A)
        Q, self.smooth_rank = ambient_basis(observation, B, rank_tolerance, profiles=profiles)
        self.background = np.ascontiguousarray(Q.T)
        self.transport = np.ascontiguousarray(used.T, np.float32)
        self.gram: Array = TransportOperator(used, Q).gram()
        energy = float(np.trace(self.gram))
        precision = precision_of(A)
        if not energy > max(PRECISION, precision) ** 2 * float(np.vdot(used, used)):
            raise InputError(NOTHING_LEFT)
        self.norm = float(np.sqrt(energy))
        self.unit = float(np.sqrt(energy / len(self.gram)))
        self.patterns = SpectralBasis(self.gram / self.unit**2, observation.hidden)
        curvatures = self.patterns.curvatures  # ascending
        self.least_curvature = max(ROUNDING, precision**2)
        self.visible = slice(int((curvatures <= self.least_curvature * curvatures[-1]).sum()), None)
        self.curvatures: Array = curvatures[self.visible]

    @property
    def pixels(self) -> int:
        """M', the pixels used."""
        return int(self.transport.shape[1])

    @cached_property
    def operator(self) -> TransportOperator:
        """A⊥ as a linear operator, (M', N)."""
        return TransportOperator(self.transport.T, self.background.T, self.gram)

    def project_out(self, rows: Image) -> Image:
        """Return rows, (J, M'), with all ambient light projected out."""
        return project_out(rows, self.background)

    def evidence(self, planes: Array) -> tuple[list[Evidence], Array]:
        """Return the evidence of photographs' planes, (K, 3, M'), and y⊥ over its level, likewise.

        Aᵀ is applied to all photographs in one product.
        """
        rows = self.project_out(planes.reshape(-1, self.pixels))
        y = np.asarray(rows, np.float64).reshape(planes.shape)
        whole, levels = (np.sqrt(np.mean(each**2, axis=(1, 2))) for each in (planes, y))
        y[levels <= ROUNDING * whole] = 0  # ambient light alone explains all of it
        levels[levels <= ROUNDING * whole] = 1
        y /= levels[:, None, None]  # single precision needs numbers near 1
        products = times_rows(rows.astype(np.float32), self.transport) * np.float32(1 / self.unit)
        coefficients = times_rows(products, self.patterns.rows).astype(np.float64)
        coefficients = coefficients.reshape(*y.shape[:2], -1)
        noises = self._noise(y, coefficients[..., self.visible])
        ratios = self._noise_to_signal(noises)
        numbers = (each.tolist() for each in (levels, ratios))
        return [Evidence(*each) for each in zip(coefficients, noises, *numbers, strict=True)], y

    def coordinates(self, evidence: Evidence) -> Array:
        """Return the coordinates of an evidence's y⊥ along the A⊥ W_k/√λ_k, (3, N')."""
        return np.asarray(evidence.coefficients[:, self.visible] / np.sqrt(self.curvatures))

    def shown(self, images: Image) -> Array:
        """Return the coefficients of the light of images, (3, N), in the visible patterns."""
        products = times_rows(np.ascontiguousarray(images, np.float64), self.gram)
        shown = times_rows(products.astype(np.float32), self.patterns.rows)
        return np.asarray(shown[:, self.visible], np.float64)

    def explicable(self, evidence: Evidence, image: Image) -> tuple[Array, Array]:
        """Return the part of y⊥ that A⊥ can explain, (3, N'), and an image's residual, over σ."""
        f = self.observation.mixed(image).T / (evidence.level * self.unit)
        scales = np.sqrt(self.curvatures) * evidence.noise[:, None]
        whole = evidence.coefficients[:, self.visible] / scales
        return whole, whole - self.shown(f) / scales

    def unexplained(self, rows: Array) -> Array:
        """Return the part of rows, (J, M'), that no hidden image and no ambient light explain."""
        return self.operator.unexplained(rows.T).T

    def response(self, light: Array) -> Array:
        """Return A⊥ᵀ of light, (K, 3, M'), as (K, 3, N)."""
        rows = np.ascontiguousarray(self.project_out(light.reshape(-1, self.pixels)), np.float32)
        return times_rows(rows, self.transport).reshape(*light.shape[:2], -1).astype(np.float64)

    def _noise(self, y: Array, coefficients: Array) -> Array:
        """Return the standard deviation of what the least-squares image leaves of y⊥, (K, 3).

        y⊥ is (K, 3, M'), its coefficients in the visible patterns are (K, 3, N').
        """
        explained = np.sum(coefficients**2 / self.curvatures, axis=-1)
        freedom = self.pixels - len(self.background) - len(self.curvatures)
        noise = residual_noise(np.sum(y * y, axis=-1), explained, freedom)
        largest = noise.max(axis=-1, keepdims=True) + 1e-30  # a black photograph has none
        return np.asarray(np.maximum(noise, largest / LARGEST_NOISE_RATIO))

    def _noise_to_signal(self, noise: Array) -> Array:
        """Return the noise's energy over the signal's, (K,), for noise, (K, 3), over the level."""
        energy = (self.pixels - len(self.background)) * np.sum(noise**2, axis=-1)
        # A signal below its own standard error is none.
        least = np.sqrt(2 * len(self.curvatures) * np.sum(noise**4, axis=-1))
        return np.asarray(energy / np.maximum(noise.shape[-1] * self.pixels - energy, least))


def ambient_basis(
    observation: Observation,
    B: Image | None,
    rank_tolerance: float = RANK_TOLERANCE,
    *,
    profiles: bool = False,
) -> tuple[Array, int]:
    """Return an orthonormal basis of all ambient light, (M', r), and how many columns are smooth.

    They come first: of range(B) and, if asked for, of `wall_profiles`, which need a B and the rows
    and columns of photographs. Each channel of each photograph with the monitor off then joins, its
    strength to be found. Their own noise is counted wherever noise is estimated from what is
    unexplained.
    """
    Q = background_basis(observation.used(B), rank_tolerance)
    shape = observation.rows_and_columns
    if profiles and Q.shape[1] and shape is not None:
        Q = joined_basis(Q, observation.used(wall_profiles(shape)))
    return joined_basis(Q, observation.ambient()), Q.shape[1]
