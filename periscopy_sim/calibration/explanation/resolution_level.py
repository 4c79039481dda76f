"""The photograph at one resolution, and how well a scene's parameters explain it there."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from contextlib import suppress
from copy import copy
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from periscopy_sim.analytic.area_transport import area_derivatives, area_transport, has_areas
from periscopy_sim.analytic.point_light import point_light_backgrounds
from periscopy_sim.calibration.explanation.discrepancy import Whitening, WhiteNoise
from periscopy_sim.calibration.explanation.evidence import Explanation
from periscopy_sim.calibration.explanation.image_fit import ImageFit, fit_image
from periscopy_sim.calibration.explanation.last_matrices import LastMatrices
from periscopy_sim.calibration.explanation.smooth_gain import SmoothGain
from periscopy_sim.calibration.prior import Prior
from periscopy_sim.errors import ClosedFormError, PhotographError, SceneError
from periscopy_sim.model.ambient import background_basis, joined_basis
from periscopy_sim.model.observation import Observation
from periscopy_sim.model.paint import Unevenness
from periscopy_sim.photograph import blackened
from periscopy_sim.rendering.scene.load import load_scenario
from periscopy_sim.rendering.transport.shadow_rays import render_transport, require_light
from periscopy_sim.scenario import Array, Scenario
from periscopy_sim.storage.pictures import area_average

Values = NDArray[np.float64]
Visit = Callable[[Values, float], None]

MOST_PATCHES = 0.6
"""Hidden patches for each pixel used, at most: a long photograph keeps few rows."""

COVERED = 0.5
"""Part of a coarse pixel that must be left by the mask; its mean is that of what is left."""


@dataclass(frozen=True)
class Rays:
    """How many make up an entry of the transport matrix, see `render_transport`."""

    samples: int
    pixel_samples: int


@dataclass(frozen=True)
class Resolution:
    """How finely a level looks."""

    photograph: int  # longest side, in pixels, see `fitted`
    hidden: int  # longest side, in patches
    finer: int  # wall points along each side of a pixel, see `area_transport`
    rays: Rays  # where areas do not serve
    slope_rays: Rays  # there, of the differences of which derivatives are made


class ResolutionLevel:
    """A photograph, (rows, columns, 3), at one resolution, explained by a scene of some parameters.

    Those in `names` vary, with a `prior`; those in `fixed` stay. The seed, of the rays, is the same
    for all values, so that noise does not hide differences. `check` raises a SceneError for a
    scenario that is not physical. Backgrounds, (rows, columns, 3) each, are photographs with the
    monitor off. With `by_area` there are no rays, see `area_transport`. `used` are the coarse
    pixels that the mask leaves, `scale` is the photograph's root mean square there,
    `overdispersion` that of what is left unexplained, see `Explanation`.
    """

    overdispersion = 1.0
    _nonnegative = False
    _whitening: Whitening | None = None
    _white_noise: WhiteNoise | None = None
    _leverage: Array | None = None

    def __init__(
        self,
        path: Path,
        fixed: Mapping[str, str],
        names: tuple[str, ...],
        prior: Prior,
        photograph: Array,
        backgrounds: Sequence[Array],
        mask: NDArray[np.bool_] | None,
        hidden: tuple[int, int],
        resolution: Resolution,
        seed: int,
        check: Callable[[Scenario], None],
        by_area: bool = False,
    ) -> None:
        self.by_area = by_area
        self.path, self.names, self.prior = path, names, prior
        self.resolution, self.seed = resolution, seed
        self._fixed, self._check = dict(fixed), check
        rows, columns = photograph.shape[:2]
        self.photograph_shape = fitted((rows, columns), resolution.photograph)
        self.hidden_shape = fitted(hidden, resolution.hidden)
        # The larger the pixels of a small photograph, the more of their area counts.
        self._larger = resolution.photograph // max(self.photograph_shape)
        self._finer, self._rays = resolution.finer, resolution.rays
        mask = np.ones((rows, columns), bool) if mask is None else mask
        coverage = area_average(mask[..., None], self.photograph_shape)
        self.used = coverage[..., 0] > COVERED + 1e-6  # ties are decided alike in mirror images
        fewer = np.sqrt(MOST_PATCHES * self.used.sum() / np.prod(self.hidden_shape))
        if fewer < 1:
            self.hidden_shape = fitted(hidden, max(1, int(fewer * max(self.hidden_shape))))

        def averaged(light: Array) -> Array:
            means = area_average(blackened(light, mask), self.photograph_shape)
            return np.asarray(means[self.used] / coverage[self.used])

        self._y = self._seen = averaged(photograph)
        self._off = {str(k): averaged(background) for k, background in enumerate(backgrounds)}
        self.scale = float(np.sqrt(np.mean(self._y**2))) if self.used.any() else 1.0
        self._smooth: Array | None = None
        self._background: Array | None = None
        self._gain = SmoothGain.none(self.used)
        self._areas = LastMatrices()  # of this level and all that are made of it

    def varying(self, names: tuple[str, ...]) -> ResolutionLevel:
        """Return the same level with other parameters that vary."""
        other = copy(self)
        other.names = names
        return other

    def differing(self) -> ResolutionLevel:
        """Return the same level with the rays of differences."""
        other = copy(self)
        other._rays = self.resolution.slope_rays
        return other

    def reseeded(self, seed: int) -> ResolutionLevel:
        """Return the same level with other rays."""
        other = copy(self)
        other.seed = seed
        return other

    def of_nonnegative_images(self) -> ResolutionLevel:
        """Return the same level, whose best images are kept from shining negatively."""
        other = copy(self)
        other._nonnegative = True
        return other

    def overdispersed(self, overdispersion: float) -> ResolutionLevel:
        """Return the same level for residuals of another overdispersion."""
        other = copy(self)
        other.overdispersion = overdispersion
        return other

    def levered(self, found: Explanation, A: NDArray[np.floating[Any]]) -> ResolutionLevel:
        """Return the same level, to take for all matrices the leverage of one that explained."""
        other = copy(self)
        other._leverage = found.leverage(A)
        return other

    def as_it_comes(self) -> ResolutionLevel:
        """Return the same level, all errors taken for white noise."""
        other = self.overdispersed(1.0)
        other._whitening = other._leverage = None
        return other

    def compared(
        self, found: Explanation, left_of: Callable[[Array], Array] = lambda errors: errors
    ) -> ResolutionLevel:
        """Return the same level, to compare errors with white noise that is left so, see there."""
        other = copy(self)
        other._white_noise = WhiteNoise.by(found, self.used, self.seed, left_of)
        return other

    def comparable(self, values: Values) -> ResolutionLevel:
        """Return the same level, `compared` with white noise as image and light leave it."""
        return self.compared(self.as_it_comes().explain(values))

    def whitened(self, found: Explanation) -> ResolutionLevel:
        """Return the same level, errors of the spectrum that an explanation leaves made white.

        The explanation is that of a level `as_it_comes`; the gain is the one that it found.
        """
        other = self.gained(found)
        if self._white_noise is not None:
            other._whitening = Whitening(self.used, self._white_noise.discrepancy(found))
        return other

    @property
    def discrepancy(self) -> float:
        """How much stronger errors are than white noise at the scale where they are strongest."""
        return 1.0 if self._whitening is None else self._whitening.discrepancy

    def evened(self, found: Explanation) -> ResolutionLevel:
        """Return the same level with the photograph as an even wall would have shown it.

        What the photographs with the monitor off show of paint is divided out, if the photograph,
        as it was explained, agrees; see `unevenness`.
        """
        if not self._off or self._smooth is None or not self._smooth.shape[1]:
            return self
        seen = Observation(
            self.used.size, self.hidden_shape, np.ones(3), self.used, self.photograph_shape,
            {name: off.T for name, off in self._off.items()},
        )  # fmt: skip
        evenness = Unevenness(self._smooth, seen).evenness(self._seen.T, found.fit.left_of_rows)
        other = copy(self)
        other._y = self._seen * evenness.T
        return other

    def gained(self, found: Explanation) -> ResolutionLevel:
        """Return the same level with the gain over the wall that an explanation found."""
        other = copy(self)
        other._gain = found.gain or self._gain
        return other

    @property
    def light(self) -> Array:
        """(used pixels, 3) the photograph as an even wall would have shown it."""
        return self._y

    @property
    def gain(self) -> Array:
        """(used pixels,) the gain over the wall by which the matrix is multiplied."""
        return self._gain.field

    def scenario(self, values: Values, finer: int = 1) -> Scenario:
        """Load the scene at some values; a SceneError says that they are not physical.

        Its photograph is that much finer than the level's.
        """
        given = {name: f"{value:.17g}" for name, value in zip(self.names, values, strict=True)}
        rows, columns = self.photograph_shape
        scenario = load_scenario(
            self.path, self.hidden_shape, self._fixed | given,
            photograph=(finer * rows, finer * columns),
        )  # fmt: skip
        if scenario.wall_texture is not None:  # it moves in the photograph as the camera does
            raise SceneError(
                f"scene '{self.path}': the wall is textured, which calibrate does not treat; mask "
                "what is drawn there, and give the wall one reflectance"
            )
        self._check(scenario)
        return scenario

    def unphysical(self, values: Values) -> SceneError | None:
        """Return why there is no scene at some values; None if there is one."""
        try:
            self.scenario(values)
        except SceneError as error:
            return error
        return None

    def matrix(self, values: Values, seed: int | None = None) -> NDArray[np.float32]:
        """Return the transport matrix at some values, (used pixels, N); by the level's own rays.

        A SceneError says that they are not physical, or that no light reaches the wall.
        """
        if self.by_area:
            with suppress(ClosedFormError):  # an occluder that went behind the monitor, say
                A = self._by_area(values)
                return A if self.used.all() else A[self.used.ravel()]
        A = render_transport(
            self.scenario(values),
            samples=self._rays.samples,
            pixel_samples=self._rays.pixel_samples * self._larger**2,
            seed=self.seed if seed is None else seed,
        )
        return A if self.used.all() else A[self.used.ravel()]

    def _by_area(self, values: Values) -> NDArray[np.float32]:
        """Return the transport matrix by areas, of all pixels, read-only."""

        def compute() -> NDArray[np.float32]:
            finer = self._finer * self._larger
            scenario = self.scenario(values, finer)
            A = area_transport(scenario, finer)
            require_light(A, scenario)
            return A

        return self._areas.at((self.names, values.tobytes()), compute)

    def derivatives(self, values: Values, offsets: Array) -> NDArray[np.float32]:
        """Return derivatives of the matrix by areas, (K, used pixels, N), see `area_derivatives`.

        Each row of the offsets, (K, P), moves one parameter to either side. A SceneError says that
        neither is physical, a ClosedFormError that areas do not serve.
        """
        finer = self._finer * self._larger
        here = self.scenario(values, finer)
        sides = [self._sides(here, values, offset, finer) for offset in offsets]
        changes = area_derivatives(here, sides, finer, self._by_area(values))
        return changes if self.used.all() else changes[:, self.used.ravel()]

    def _sides(
        self, here: Scenario, values: Values, offset: Values, finer: int
    ) -> tuple[Scenario, Scenario, float]:
        """Return the scenes on either side, and how far apart; `here` for one not physical."""
        sides = []
        for sign in (-1, 1):
            try:
                side = self.scenario(values + sign * offset, finer)
                if not has_areas(side, finer):
                    raise ClosedFormError(f"scene '{self.path}': areas serve on neither side")
                sides.append(side)
            except SceneError as error:
                unphysical = error
                sides.append(here)
        behind, ahead = sides
        if behind is ahead:
            raise unphysical
        apart = offset.sum() * ((behind is not here) + (ahead is not here))
        return behind, ahead, float(apart)

    def has_areas(self, values: Values) -> bool:
        """Return whether the scene at some values needs no rays."""
        finer = self._finer * self._larger
        return has_areas(self.scenario(values, finer), finer)

    def by_rays(self) -> ResolutionLevel:
        """Return the same level, its matrices rendered by rays."""
        other = copy(self)
        other.by_area = False
        return other

    def background(self, values: Values) -> Array:
        """Return an orthonormal basis of range(B), of ambient light, (used pixels, r).

        The photographs with the monitor off are columns of B. The point lights as seen at the first
        values are taken for all: of the light after a camera's move by a centimetre or 2 degrees at
        most 3e-7 lies outside of what they span. A
        PhotographError says that there are too few pixels to tell it from the signal.
        """
        if self._background is None:
            B = point_light_backgrounds(self.scenario(values))[self.used.ravel()]
            self._smooth = background_basis(B)
            basis = joined_basis(self._smooth, np.hstack([B[:, :0], *self._off.values()]))
            if len(basis) <= 2 * basis.shape[1]:
                raise PhotographError(
                    f"at {self.photograph_shape[0]}x{self.photograph_shape[1]} pixels "
                    f"{len(basis)} of them are used, too few beside {basis.shape[1]} kinds of "
                    "ambient light; give a larger photograph, or mask less of it"
                )
            self._background = basis
        return self._background

    def explain(self, values: Values, seed: int | None = None) -> Explanation:
        """Explain the photograph by the scene at some values; rays and errors as in `matrix`.

        The evidence is with the prior's penalty.
        """
        return self.explained_by(self.matrix(values, seed), values)

    def judged(self, values: Values, seed: int | None = None) -> Explanation:
        """Explain the photograph as `explain` does, errors made white by what these values leave.

        Where a place is wrong its errors are structured as those of another are not. By the
        spectrum of either its own errors count too little: it takes itself for better.
        """
        A, plain = self.matrix(values, seed), self.as_it_comes()
        plain._leverage = self._leverage
        level = plain.whitened(plain.explained_by(A, values)).overdispersed(self.overdispersion)
        return level.explained_by(A, values)

    def explained_by(
        self, A: NDArray[np.floating[Any]], values: Values, fit: ImageFit | None = None
    ) -> Explanation:
        """Explain the photograph by a transport matrix, (used pixels, N), at some values.

        If that is known, `fit` is the image's by the same matrix, gain and filter.
        """
        Q, y, volume = self.background(values), self._y, 0.0
        if self._whitening is not None:
            Q, root = np.linalg.qr(self._whitening(Q))
            y = np.asarray(self._whitening(y), np.float64)
            # Of light that is free: of what the filter makes of it, its spread must not count.
            volume = 6 * float(np.log(np.abs(np.diag(root))).sum()) / self.overdispersion
        if fit is None:
            bright = self._gain.field[:, None] * A
            fit = fit_image(bright, Q, y, self.hidden_shape, self._whitening, self._nonnegative)
        found = Explanation.of(fit, self.overdispersion).with_gain(self._gain, A, self._leverage)
        evidence, darkness = (each + volume for each in (found.evidence, found.darkness))
        return replace(found, evidence=evidence + self.prior.penalty(values), darkness=darkness)

    def picture(self, residuals: Array) -> Array:
        """Return the used pixels' residuals over the scale, (rows, columns, 3), 0 elsewhere."""
        laid = np.zeros((*self.photograph_shape, 3))
        laid[self.used] = residuals / self.scale
        return laid

    def gain_of(self, found: Explanation) -> Array:
        """Return the gain over the wall that an explanation found, (rows, columns), 1 elsewhere."""
        laid = np.ones(self.photograph_shape)
        laid[self.used] = (found.gain or self._gain).field
        return laid

    def evidence(self, values: Values) -> float:
        """Return the evidence at some values; infinite where they are not physical."""
        return _or_infinite(self.explain, values)

    def judgement(self, values: Values) -> float:
        """Return the evidence at some values by their own errors, see `judged`, or infinity."""
        return _or_infinite(self.judged, values)


def _or_infinite(explain: Callable[[Values], Explanation], values: Values) -> float:
    try:
        return explain(values).evidence
    except SceneError:
        return np.inf


def fitted(size: tuple[int, int], longest: int) -> tuple[int, int]:
    """Return (rows, columns) shrunk in proportion, the longer to at most `longest`."""
    factor = min(1.0, longest / max(size))
    rows, columns = (max(1, round(factor * n)) for n in size)
    return rows, columns
