"""A scene fitted to the conditions of photographs: once, for every photograph under them.

    y⊥ = A⊥ f + n,   A⊥ = A − Q QᵀA,   y⊥ = y − Q Qᵀ y

Q is an orthonormal basis of all ambient light, so that least squares of y⊥ are those of y on
[A, B] with the ambient light fitted freely: the very information that the paper's P keeps.

With a colour matrix M, a photograph's channel is y_j = Σ_k M_jk g_k A f_k + B c_j + n_j, g the
wall's colour. So a grey wall would show Σ_k (M_jk g_k/g_j) A f_k. Of a textured wall A and B hold
the albedo of each pixel, and g its colour beside that.

Noise is estimated from neighbouring pixels, where no scene is needed, or from a fit's residual.
The difference D = (1, −2, 1)ᵀ(1, −2, 1)/6 removes light that varies linearly down or across, most
of penumbrae, and keeps the whole variance of white noise. The median of its size is that of noise
even where some edges remain. Where neighbours share noise, as after rectification, this estimate
is too small.

A `Correction` describes what A f + B c + n does not; each is an object in a list.
A method for stills is given a list of corrections; a method without them is the plain method. The
gain over the wall has gained on a real photograph. Paint is measured on rendered photographs alone,
and acts where photographs with the monitor off are given.
"""

import warnings
from collections.abc import Callable, Mapping, Sequence
from dataclasses import KW_ONLY, dataclass, replace
from functools import cached_property
from statistics import NormalDist
from typing import Any, Protocol, Self

import numpy as np
from scipy import linalg

from periscopy_sim.hidden import Hidden
from periscopy_sim.model import transport_operator
from periscopy_sim.model.spectral_basis import MOST_PATTERNS, SpectralBasis, laplacian
from periscopy_sim.model.uncertainty import UncertainTransport
from periscopy_sim.numerics import Array, Image, Mask, precision_of
from periscopy_sim.numerics.products import combine_rows, project_out, times_rows
from periscopy_sim.numerics.validation import LIGHT_RANGE, InputError, checked_matrix, plain_array
from periscopy_sim.photograph import CODES, Photograph, check_size

FEWEST = 25
"""Pixels with all their neighbours, below which the noise is unknown."""

SINGLE_ROUNDING = float(np.finfo(np.float32).eps)
"""Noise over a photograph's size that rounding in single precision makes."""

STRONGEST = 64
"""Patterns whose light is subtracted before the noise is a difference of sums of squares, whose
rounding in single precision would else be as large as the noise of a photograph at 70 dB."""


def residual_noise(energy: Array, explained: Array, freedom: int) -> Array:
    """Return σ of white noise from the residual of least squares, of the shape of the energies.

    σ² = (‖y⊥‖² − ‖A⊥ f̂‖²)/freedom, or what rounding makes, if more. The energy is ‖y⊥‖² of each
    photograph's channels, `explained` is ‖A⊥ f̂‖², and the freedom counts the pixels less the
    dimensions of ambient light and f̂. It warns where more is explained than there is.
    """
    if np.any(explained - energy > 10 * SINGLE_ROUNDING * energy):
        warnings.warn(
            "rounding explains more of the photograph's light than there is, so that its noise "
            "counts as none: reconstruct fewer patches",
            stacklevel=2,
        )
    rest = np.maximum(energy - explained, SINGLE_ROUNDING**2 * energy)
    return np.asarray(np.sqrt(rest / max(freedom, 1)))


def noise_beside(lights: Image, y: Array, coordinates: Array, freedom: int) -> Array:
    """Return σ, (K, C), of y⊥, (K, C, M'), from what orthonormal rows of light leave of it.

    The lights are (N', M') in single precision, the strongest last; y⊥ has the coordinates,
    (K, C, N'), along them. The freedom is that of `residual_noise`.
    """
    from periscopy_sim.numerics.products import combine_rows  # compiled: readers need no compiler

    weak, strong = np.split(coordinates, [-STRONGEST], axis=-1)
    strong = strong.reshape(-1, strong.shape[-1]).astype(np.float32)
    left = y - combine_rows(strong, lights[-STRONGEST:]).reshape(y.shape)
    energy = np.sum(y * y, axis=-1)
    rest = np.sum(left**2, axis=-1) - np.sum(weak**2, axis=-1)
    return residual_noise(energy, energy - rest, freedom)


def second_differences(planes: Array) -> Array:
    """Return D of (K, rows, columns) planes, (K, rows − 2, columns − 2); NaN beside NaN."""
    return np.asarray(np.diff(np.diff(planes, n=2, axis=1), n=2, axis=2) / 6)


def camera_noise(planes: Array) -> Array | None:
    """Return the standard deviation of white noise in each of (K, rows, columns) planes, (K,).

    NaN marks pixels that are not used. None where fewer than `FEWEST` pixels have all their
    neighbours.
    """
    differences = np.abs(second_differences(planes)).reshape(len(planes), -1)
    used = np.isfinite(differences).all(axis=0)
    if np.count_nonzero(used) < FEWEST:
        return None
    return np.asarray(np.median(differences[:, used], axis=1) / NormalDist().inv_cdf(0.75))


def relative_noise(photograph: Photograph) -> float | None:
    """Return the least noise of a channel over its mean.

    None where `camera_noise` returns None, or all is black.
    """
    noise, light = camera_noise(photograph.planes), np.nanmean(photograph.planes, axis=(1, 2))
    if noise is None or not (light > 0).any():
        return None
    return float(np.min(noise[light > 0] / light[light > 0]))


PRECISION = 3e-5
"""Relative rounding of A by areas (1.5e-5 for the plate, 4e-5 for the chair)."""

LARGEST_NOISE_RATIO = 30
"""Largest ratio of the noises of two channels; it bounds a black channel's noise from below."""


@dataclass(frozen=True, eq=False)
class Evidence:
    """The information on the hidden image in one photograph.

    The coefficients are those of y⊥ over its level and A⊥ over a patch's root mean square energy.
    """

    coefficients: Array  # (C, K) WᵀA⊥ᵀ y⊥ of K patterns, in the camera's channels
    noise: Array  # (C,) standard deviation of the noise in y⊥, over the level
    level: float  # root mean square of y⊥
    noise_to_signal: float  # energy of the noise in y⊥ over that of the signal
    rest: Image | None = None  # (C, N) A⊥ᵀ y⊥ beyond K < N patterns

    @property
    def mean_noise(self) -> float:
        """The σ that λ is counted in: the mean over the channels."""
        return float(self.noise.mean())


@dataclass(frozen=True, eq=False)
class FittedPhotograph:
    """A photograph in the pixels used, as one scene explains it."""

    planes: Array  # (C, M') each channel over the wall's colour
    fit: "Fit"

    @property
    def evidence(self) -> Evidence:
        """The photograph's information on its hidden image."""
        return self._projected[0]

    @property
    def y(self) -> Array:
        """(C, M') y⊥ over its level."""
        return self._projected[1]

    @cached_property
    def _projected(self) -> tuple[Evidence, Array]:
        (evidence,), (y,) = self.fit.evidence(self.planes[None])
        return evidence, y


@dataclass(frozen=True, eq=False, repr=False)
class Fit:
    """A scene, and the conditions of the photographs that it is fitted to.

    The constructor checks kinds and sizes; everything else is computed when it is first used, and
    kept. No vector has the pixels that the mask excludes, whatever they hold.

    It raises a ValueError if A or B is no matrix, sizes do not fit, the mask leaves fewer pixels
    than patches, the wall has no colour for each channel, or a photograph with the monitor off has
    no light; when used first, if A or B is not finite in the pixels used, or B explains all of A.
    """

    A: Image  # (M, N) light transport matrix
    B: Image | None = None  # (M, L) prototype backgrounds
    _: KW_ONLY
    hidden: Hidden  # the surfaces of the N patches
    photograph_shape: tuple[int, int] | None = None  # (rows, columns); None checks M alone
    # Positive colour of the wall by channel, (C,), or of each pixel, (M, C); None for grey.
    channel_gain: Image | None = None
    paint: Image | None = None  # (M, 1) brightness of the wall in A and B; None for an even wall
    # A photograph, whose mask, photographs with the monitor off and colour matrix count.
    conditions: Photograph | None = None
    rank_tolerance: float = (
        transport_operator.RANK_TOLERANCE
    )  # of B's singular values, see `background_basis`
    # Whether `wall_profiles` join B, where the photograph's rows and columns are known.
    profiles: bool = False
    # Whether planes are in the monitor's primaries, their noise mixed, not in the camera's.
    unmixes: bool = False
    uncertain: UncertainTransport | None = None  # what the scene's errors do to light; None: right

    def __post_init__(self) -> None:
        vars(self)["A"] = checked_matrix(self.A, "A")  # the fields are frozen
        if self.B is not None:
            vars(self)["B"] = checked_matrix(self.B, "B")
        (M, N), B, gain = self.A.shape, self.B, self.channel_gain
        if self.hidden.patches != N:
            raise InputError(
                f"a hidden image of {self.hidden.sizes} patches does not fit A's {N} columns"
            )
        if B is not None and len(B) != M:
            raise InputError(f"B has {len(B)} rows; they must match the {M} of A")
        if gain is not None and not (
            np.shape(gain)[:-1] in ((), (M,)) and (np.asarray(gain) > 0).all()
        ):
            raise InputError(f"the wall's channel gains must be positive numbers, not {gain}")
        if self.conditions is not None:
            self._check_size((1, *self.conditions.values.shape))
            if self.pixels < N <= M:
                raise InputError(
                    f"the mask leaves {self.pixels} pixels for {N} patches: leave out less of the "
                    "wall, or use fewer patches"
                )
            _ = self.mixing, self.monitor_off

    @classmethod
    def of_views(cls, fits: Sequence[Self], weights: Array) -> Self:
        """Return the fit of the pixels that several views use, view below view, by weights of A.

        Its A⊥ is that of each view times its weight. It counts errors of the scene that all views
        count. An InputError says that the views mix colours differently.
        """
        first, known = fits[0], [fit.uncertain for fit in fits if fit.uncertain is not None]
        if any(not np.array_equal(np.array(fit.mixing), np.array(first.mixing)) for fit in fits):
            raise InputError(
                "the views' colour matrices, over the colours of their walls, differ; give cameras "
                "of one kind and walls of one colour"
            )

        def slopes(image: Image | Mapping[str, Image]) -> Image:
            each = zip(weights, known, fits, strict=True)
            return np.hstack([w * own.slopes(image)[:, fit.kept] for w, own, fit in each])

        all_count = len(known) == len(fits) and len({each.names for each in known}) == 1
        A = np.concatenate([np.float32(w) * fit.rows for w, fit in zip(weights, fits, strict=True)])
        uncertain = replace(known[0], slopes=slopes) if all_count else None
        whole = cls(A, hidden=first.hidden, uncertain=uncertain)
        Q = linalg.block_diag(*(fit.basis for fit in fits))
        vars(whole).update(mixing=first.mixing, _ambient=(Q, Q.shape[1]))
        return whole

    def __getstate__(self) -> dict[str, Any]:
        """Return the state without light that follows from the rest."""
        return {n: each for n, each in vars(self).items() if n not in ("lights", "_motions")}

    @property
    def mask(self) -> Mask | None:
        """(M,) True in the M' pixels used; None for all."""
        mask = None if self.conditions is None else self.conditions.mask
        return None if mask is None else mask.ravel()

    @property
    def kept(self) -> Mask | slice:
        """Index of the M' pixels used among all."""
        return slice(None) if self.mask is None else self.mask

    @property
    def pixels(self) -> int:
        """M', the number of pixels used."""
        return self.A.shape[0] if self.mask is None else int(np.count_nonzero(self.mask))

    @property
    def shape(self) -> tuple[int, int] | None:
        """(rows, columns) of photographs, as given or as the conditions have them, if known."""
        known = self.photograph_shape
        return self.conditions.shape if known is None and self.conditions is not None else known

    def gain(self, channels: int) -> Array:
        """Return the wall's colour in so many channels, (1, C), or of each pixel used, (M', C).

        A photograph of one channel shows a texture's mean over the channels, and no colour of an
        even wall. An InputError says that the channels do not fit.
        """
        known = self.channel_gain
        values = np.ones((1, channels)) if known is None else np.atleast_2d(np.asarray(known))
        is_even = known is None or np.ndim(known) == 1
        gain = np.asarray(values if is_even else values[self.kept], np.float64)
        if gain.shape[1] == channels:
            return gain
        if channels == 1:
            return np.ones((1, 1)) if is_even else gain.mean(axis=1, keepdims=True)
        if np.allclose(gain, gain[:, :1], rtol=1e-6):
            return np.tile(gain[:, :1], channels)
        raise InputError(
            f"the photograph has {channels} channels, the wall's colour {gain.shape[1]}; make the "
            f"wall grey in the scene, or give {gain.shape[1]} channels, or one"
        )

    @cached_property
    def mixing(self) -> Array | None:
        """(C, P) from images in primaries to grey planes, mean over pixels; None for identity."""
        if self.conditions is None or self.conditions.colour_matrix is None:
            return None
        M = self.conditions.colour_matrix.matrix
        channels, primaries = M.shape
        ratios = self.gain(primaries)[:, None] / self.gain(channels)[..., None]
        return np.asarray(M * ratios.mean(axis=0))

    @cached_property
    def monitor_off(self) -> dict[str, Array]:
        """(C, M') planes of the photographs with the monitor off, by name."""
        planes = {}
        given = {} if self.conditions is None else self.conditions.monitor_off
        for name, light in given.items():
            try:
                planes[name] = self._grey(np.asarray(light)[None])[0]
            except InputError as error:
                raise InputError(f"{name}: {error}") from None
            if not planes[name].max(initial=0) > 0:
                raise InputError(f"{name}: no value is positive where the wall is used")
        return planes

    def used(self, matrix: Image | None) -> Image:
        """Return the rows of (M, K) in the M' pixels used; of None, (M', 0)."""
        matrix = np.zeros((self.A.shape[0], 0)) if matrix is None else matrix
        return matrix[self.kept]

    def on_wall(self, light: Image) -> Image:
        """Return smooth light, (M, K), as it shows on the wall in the pixels used."""
        return self.used(light if self.paint is None else light * self.paint)

    def planes(self, photographs: Image) -> Array:
        """Return photographs as a grey wall would show them, (K, C, M') float64.

        They are (K, rows, columns, C) or (K, M, C), of the right size, and finite where used. Each
        channel is divided by the wall's gain, and unmixed if the fit unmixes.
        """
        grey = self._grey(np.asarray(photographs))
        if self.mixing is None or not self.unmixes:
            return grey
        return np.asarray(np.linalg.pinv(self.mixing) @ grey)

    def vectors(self, photograph: Image) -> Array:
        """Return `planes` of one photograph as the y of y = A f, (M', C) float64."""
        return np.ascontiguousarray(self.planes(plain_array(photograph)[None])[0].T)

    def mixed(self, image: Image) -> Array:
        """Return an image in the channels of the planes, (N, C) float64."""
        f = np.asarray(self.hidden.vector(image), np.float64)
        return f if self.mixing is None or self.unmixes else f @ self.mixing.T

    def placed(self, values: Image) -> Array:
        """Put (M', K) values of the pixels used into (K, rows, columns), NaN elsewhere."""
        assert self.shape is not None
        planes = np.full((values.shape[1], self.A.shape[0]), np.nan)
        planes[:, self.kept] = values.T
        return planes.reshape(-1, *self.shape)

    @cached_property
    def _ambient(self) -> tuple[Array, int]:
        """An orthonormal basis of all ambient light, (M', r), and how many columns are smooth."""
        Q = transport_operator.background_basis(self.used(self.B), self.rank_tolerance)
        if self.profiles and Q.shape[1] and self.shape is not None:
            Q = transport_operator.joined_basis(
                Q, self.on_wall(transport_operator.wall_profiles(self.shape))
            )
        return transport_operator.joined_basis(Q, self.monitor_off_columns), Q.shape[1]

    @property
    def monitor_off_columns(self) -> Image:
        """(M', K C) the columns of ambient light that K photographs with the monitor off show."""
        return np.hstack([self.used(None), *(each.T for each in self.monitor_off.values())])

    @property
    def whole_background(self) -> Image:
        """(M, L + K C) B beside these columns, which are 0 outside the mask."""
        B = np.zeros((self.A.shape[0], 0)) if self.B is None else self.B
        if not self.monitor_off:
            return B
        whole = np.nan_to_num(self.placed(self.monitor_off_columns))
        return np.hstack([B, whole.reshape(len(whole), -1).T])

    @property
    def basis(self) -> Array:
        """(M', r) Q, an orthonormal basis of all ambient light."""
        return self._ambient[0]

    @property
    def smooth_rank(self) -> int:
        """Number of the first columns of Q, which need no photograph with the monitor off."""
        return self._ambient[1]

    @cached_property
    def background(self) -> Array:
        """(r, M') Qᵀ."""
        return np.ascontiguousarray(self.basis.T)

    @cached_property
    def rows(self) -> Image:
        """(M', N) the rows of A used: a copy only where there is a mask."""
        return self.A[self.kept]

    @cached_property
    def operator(self) -> transport_operator.TransportOperator:
        """A⊥ as a linear operator, (M', N)."""
        return transport_operator.TransportOperator(self.rows, self.basis)

    @cached_property
    def norm(self) -> float:
        """‖A⊥‖_F."""
        least = max(PRECISION, precision_of(self.A)) ** 2
        if not self.operator.squared_norm > least * self.operator.whole_squared_norm:
            raise InputError(transport_operator.NOTHING_LEFT)
        return float(np.sqrt(self.operator.squared_norm))

    @property
    def unit(self) -> float:
        """‖A⊥‖_F/√N, over which f is near 1 in units of y⊥."""
        return self.norm / float(np.sqrt(self.hidden.patches))

    @cached_property
    def patterns(self) -> SpectralBasis:
        """The spectral basis of A⊥ᵀA⊥ over the square of the unit, `MOST_PATTERNS` at most."""
        if self.hidden.patches <= MOST_PATTERNS:
            return SpectralBasis.of_gram(self.operator.gram / self.unit**2, self.hidden)
        count = min(MOST_PATTERNS, self.pixels)
        return SpectralBasis.strongest(self.operator, self.hidden, count)

    @cached_property
    def lights(self) -> Image:
        """(N', M') the visible patterns' light over its norm, A⊥ W_k/√λ_k: orthonormal rows."""
        return self.patterns.lights(self.operator, self.unit, self.visible)

    @cached_property
    def least_curvature(self) -> float:
        """Fraction of the largest curvature up to which a curvature counts as rounding of A."""
        return max(transport_operator.ROUNDING, precision_of(self.A) ** 2)

    @cached_property
    def visible(self) -> slice:
        """Slice of the patterns that the wall shows, N' of them."""
        curvatures = self.patterns.curvatures  # ascending
        hidden = curvatures <= self.least_curvature * curvatures[-1]
        return slice(int(hidden.sum()), None)

    @cached_property
    def curvatures(self) -> Array:
        """(N',) the visible patterns' curvatures."""
        return self.patterns.curvatures[self.visible]

    def project_out(self, rows: Image) -> Image:
        """Return rows, (J, M'), with all ambient light projected out."""
        return project_out(rows, self.background)

    def evidence(self, planes: Array) -> tuple[list[Evidence], Array]:
        """Return the evidence of photographs' planes, (K, C, M'), and y⊥ over its level, likewise.

        The patterns' light is read once for all photographs.
        """
        y, levels = self._projected_planes(planes)
        coordinates = self.response(y)
        noises = self._with_floor(noise_beside(self.lights, y, coordinates, self._freedom))
        coefficients = np.zeros((*y.shape[:2], len(self.patterns.rows)))
        coefficients[..., self.visible] = coordinates * np.sqrt(self.curvatures)
        ratios = self._noise_to_signal(noises)
        numbers = (each.tolist() for each in (levels, ratios))
        each = zip(coefficients, noises, *numbers, self._rests(y, coefficients), strict=True)
        return [Evidence(*one) for one in each], y

    def single_evidence(self, planes: Array) -> Evidence:
        """Return the evidence of one photograph's planes, (C, M').

        With a basis of all patterns it does not compute their light, which takes longer than the
        rest where a scene serves for one photograph.
        """
        exact = self.patterns.exact
        if exact is None:
            return self.evidence(planes[None])[0][0]
        (y,), (level,) = self._projected_planes(planes[None])
        coefficients = (exact @ self.operator.rmatmat(y.T)).T / self.unit
        shown = np.sum(coefficients[:, self.visible] ** 2 / self.curvatures, axis=1)
        noise = self._with_floor(residual_noise(np.sum(y**2, axis=1), shown, self._freedom))
        return Evidence(coefficients, noise, float(level), float(self._noise_to_signal(noise)))

    def _projected_planes(self, planes: Array) -> tuple[Array, Array]:
        """Return y⊥ of photographs' planes, (K, C, M'), over its level, and the levels, (K,)."""
        y = np.asarray(self.project_out(planes.reshape(-1, self.pixels)), np.float64)
        y = y.reshape(planes.shape)
        whole, levels = (np.sqrt(np.mean(each**2, axis=(1, 2))) for each in (planes, y))
        y[levels <= transport_operator.ROUNDING * whole] = (
            0  # ambient light alone explains all of it
        )
        levels[levels <= transport_operator.ROUNDING * whole] = 1
        return y / levels[:, None, None], levels  # single precision needs numbers near 1

    def _rests(self, y: Array, coefficients: Array) -> Sequence[Image | None]:
        """Return the `rest` of evidences, (K, C, N), from y⊥ and the coefficients."""
        if self.patterns.is_whole:
            return [None] * len(coefficients)
        rows = y.reshape(-1, self.pixels).astype(np.float32)
        products = self.operator.images_of(rows) / np.float32(self.unit)
        flat = coefficients.reshape(len(rows), -1).astype(np.float32)
        combined = combine_rows(flat, self.patterns.rows)
        rest = products - (self._laplacian @ combined.T).T
        return list(rest.reshape(*coefficients.shape[:2], -1))

    def coordinates(self, evidence: Evidence) -> Array:
        """Return the coordinates of an evidence's y⊥ along the patterns' light, (C, N')."""
        return np.asarray(evidence.coefficients[:, self.visible] / np.sqrt(self.curvatures))

    def coordinates_of(self, images: Image) -> Image:
        """Return the coordinates of A⊥ f along the patterns' light, (C, N'), of (C, N) images f."""
        smoothed = np.ascontiguousarray((self._laplacian @ images.T).T, np.float32)
        scales = (np.sqrt(self.curvatures) * self.unit).astype(np.float32)
        return times_rows(smoothed, self.patterns.rows[self.visible]) * scales

    @cached_property
    def _laplacian(self) -> Any:
        return laplacian(self.hidden.differences)

    @property
    def factor(self) -> Array:
        """(N', N) F, where A⊥ = UᵀF and U is the patterns' light: FᵀF is A⊥ᵀA⊥."""
        rows = self.patterns.rows[self.visible].astype(np.float64)
        scales = np.sqrt(self.curvatures)[:, None] * self.unit
        return np.asarray(scales * (self._laplacian @ rows.T).T)

    def unexplained(self, rows: Array) -> Array:
        """Return the part of rows, (J, M'), that no hidden image and no ambient light explain."""
        return self.operator.unexplained(rows.T).T

    def response(self, light: Array) -> Array:
        """Return the coordinates of light, (K, C, M'), along the patterns' light, (K, C, N')."""
        rows = np.ascontiguousarray(light.reshape(-1, self.pixels), np.float32)
        return times_rows(rows, self.lights).reshape(*light.shape[:2], -1).astype(np.float64)

    def motions(self, image: Image | Mapping[str, Image]) -> Array | None:
        """Return what the scene's errors do to an image's light, (K, 3, M'); the latest is kept.

        None of a scene that is right.
        """
        if self.uncertain is None:
            return None
        key, latest = self.hidden.vector(image).tobytes(), vars(self).get("_motions")
        if latest is None or latest[0] != key:
            latest = key, self.uncertain.lights(image, self.mask)
            vars(self)["_motions"] = latest
        lights: Array = latest[1]
        return lights

    @property
    def _freedom(self) -> int:
        """Pixels less the dimensions of ambient light and of images."""
        return self.pixels - len(self.background) - len(self.curvatures)

    def _with_floor(self, noise: Array) -> Array:
        """Return the standard deviation of noise, (..., C), none far below another channel's."""
        largest = noise.max(axis=-1, keepdims=True) + 1e-30  # a black photograph has none
        return np.asarray(np.maximum(noise, largest / LARGEST_NOISE_RATIO))

    def _noise_to_signal(self, noise: Array) -> Array:
        """Return the noise's energy over the signal's, (K,), for noise, (K, C), over the level."""
        energy = (self.pixels - len(self.background)) * np.sum(noise**2, axis=-1)
        # A signal below its own standard error is none.
        least = np.sqrt(2 * len(self.curvatures) * np.sum(noise**4, axis=-1))
        return np.asarray(energy / np.maximum(noise.shape[-1] * self.pixels - energy, least))

    def _grey(self, photographs: Image) -> Array:
        """Return checked photographs over the wall's gain, (K, C, M'), in the camera's channels."""
        if photographs.dtype.kind not in "buif":
            raise InputError(f"the photograph is of type {photographs.dtype}; give real numbers")
        if photographs.dtype == np.uint8:
            warnings.warn(f"the photograph is of {CODES}", stacklevel=5)
        self._check_size(photographs.shape)
        values = photographs.reshape(len(photographs), self.A.shape[0], photographs.shape[-1])
        planes = np.moveaxis(values[:, self.kept], -1, 1)
        grey = np.divide(planes, self.gain(planes.shape[1]).T, order="C", dtype=np.float64)
        if not np.isfinite(grey).all():
            raise InputError("the photograph must be finite")
        largest = float(np.abs(grey).max(initial=0))
        if largest > 0 and not LIGHT_RANGE[0] <= largest <= LIGHT_RANGE[1]:
            raise InputError(
                f"the photograph's largest value is {largest:.1e}; scale it to between "
                f"{LIGHT_RANGE[0]:g} and {LIGHT_RANGE[1]:g}"
            )
        return grey

    def _check_size(self, shape: tuple[int, ...]) -> None:
        """Reject photographs, (K, ..., C), of another size or of other channels."""
        size, known, M = shape[1:-1], self.shape, self.A.shape[0]
        if known is not None and len(size) == 2:
            check_size(size, known, "the photograph")
        if np.prod(size, dtype=int) != M or not size or not shape[-1]:
            raise InputError(
                f"the photograph has shape {shape[1:]}; A has {M} rows, so it must be (rows, "
                f"columns, channels) with rows x columns = {M}"
            )
        matrix = None if self.conditions is None else self.conditions.colour_matrix
        if matrix is not None and (count := len(matrix.matrix)) != shape[-1]:
            raise InputError(f"the colour matrix has {count} rows for {shape[-1]} channels")


ERROR_RATE = 1e-4
"""Largest fraction of photographs of a right model in which a correction has an effect. In scenes a
little wrong, 18 gains of a probability between this and 1e-3 cost 0.2 dB in the mean."""

RESOLVED = 1e-3
"""Sine of the angle between two fields, below which they count as equal: a thousand times single
precision's."""

FirstImage = Callable[[FittedPhotograph], Array]
"""Returns a first hidden image, (R, C, 3), of a photograph."""


class Correction(Protocol):
    """A correction, made for one scene from its `Fit`."""

    def __call__(
        self, photograph: FittedPhotograph, first_image: FirstImage
    ) -> tuple[FittedPhotograph, Mapping[str, Any]]:
        """Return the corrected photograph, and numbers by name for a summary.

        A correction that has no effect returns the same photograph.
        """
