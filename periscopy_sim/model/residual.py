"""The residual of one photograph: its size, the size of noise alone, and whether the scene fits.

    r = y − A f̂ − B ĉ

Another hidden image may explain a part of r, which is no fault of the scene. The verdict therefore
compares the rest of r, which no image explains, with white noise after the same fit.
Blurred, white noise keeps a known fraction of its energy; misplaced geometry, bounced light,
vignetting and values that are not linear are smooth and keep more. Uneven paint is as white as
noise, and equal in all channels, which a camera's noise is not.

A long exposure shows a misfit that harms no image. The verdict therefore also asks for the cost.
The rest of r, with random phases, is light of the same spectrum that images do explain in part. It
moves the estimate of a white image of variance v, that of f̂, by H⁻¹A⊥ᵀr/σ² with
H = A⊥ᵀA⊥/σ² + 1/v. Noise leaves such an estimate an error of variance tr H⁻¹/N.

Two remedies are tried on the rest of r. Other values of the scene's numbers add Σ u_k T_k, T_k what
a standard error of number k does to A f̂ and u ~ N(0, I). Paint is a factor of all light, equal in
all channels and finer than shadows. Each counts by the fraction of the misfit that it explains
beyond chance: what the T_k explain elsewhere on the wall, and one channel's part of noise.
"""

from collections.abc import Mapping
from dataclasses import dataclass, field, replace
from typing import Any, Literal

import numpy as np
from scipy import linalg, ndimage, special

from periscopy_sim.model.fit import FEWEST, SINGLE_ROUNDING, Fit, second_differences
from periscopy_sim.model.paint import moved
from periscopy_sim.model.transport_operator import LARGEST_GRAM, TransportOperator
from periscopy_sim.numerics import Array

Diagnosis = Literal["fits", "does_not_fit", "unknown"]
"""Verdict on the scene; ``unknown`` if too few pixels have neighbours, or the image is no
least-squares fit."""

DRAWS = 24
"""Draws of white noise; with 6, one right scene in twenty of 16 x 16 pixels does not fit."""

BLUR = 2.0
"""Standard deviation in pixels of the Gaussian that parts smooth errors from noise."""

EXCESS = 2.0
"""Energy of a blurred residual over that of noise, above which a misfit is no chance. The true
chair scene has 1.5 at most (63 x 63 pixels, noise of all kinds), with an A of 16 rays a patch 1.2
(29 x 36 patches) to 5.6 (9 x 11), the real chair photograph 35."""

LARGE_UNEXPLAINED = 0.03, 3.0
"""Unexplained light, over the photograph and over what noise alone would leave, above which an
image is reported as unreliable whatever the cause. For the true chair scene (SBR 0.5, 40 to 80 dB)
methods leave 2 % at most, but for `truncated-svd`, which leaves 5 to 20 %."""

MATERIAL = 2.0
"""Unexplained light over what noise alone would leave, above which it is no noise. Channels of
path-traced photographs share noise, which makes up to 1.8 of a grey picture at 60 dB."""

COSTLY = 0.2
"""Cost above which the scene does not fit: the image's mean squared error then is about twice that
of the right scene, or more, since images explain the larger part of most misfits. At 60 dB and an
SBR of 0.5 the chair (63 x 63 pixels) moved by 1 mm costs 0 and doubles the error, by 2 mm 0.4 and
makes it four times as large; 24 right scenes of chair and plate cost 0."""

SURROGATES = 8
"""Fields of random phases that the cost is averaged over."""

CHANCE = 6.0
"""Standard deviations of white noise's cost below which a misfit that is not smooth is chance: with
4, one right scene in 40 (20 patches, uneven noise) does not fit."""

ROUNDED = 10 * SINGLE_ROUNDING
"""Unexplained light over the photograph's that counts as rounding."""

HELPS = {"numbers": 0.05, "paint": 0.5, "patches": 0.25}
"""Least fraction of a misfit that a remedy explains if it helps (64 x 64 pixels, noise 0.13 %). One
linear step for a box 5, 10 and 20 mm off explains 0.18, 0.15 and 0, for a wrong monitor or paint 0;
paint whose grain is blurred by 0, 0.8 and 1.5 pixels explains 0.93, 0.67 and 0.28, the box 0.2.
Detail of pictures of 29 x 36 and 45 x 54 patches within 15 x 18 explains 0.46 to 0.78 (chair, 63
pixels, 60 dB), of 12 x 14 within 6 x 7 0.31 (32 pixels), and passes for paint by 0.54 to 0.73; a
chair 5 mm off is 0.11 and 0.33, paint 0."""

ELSEWHERE, BY_CHANCE = 5, 0.05
"""Places of the T_k on the wall, the right one among them, and the fraction of unrelated misfits
that the right place explains as much better than the others."""

FINE = 1.0
"""Standard deviation in pixels of the Gaussian whose blur is subtracted from paint: at 2 pixels the
misfit of a misplaced box passes for paint."""


@dataclass(frozen=True, eq=False)
class Residual:
    """The part of a photograph that a scene and a hidden image do not explain.

    Attributes
    ----------
    light
        (rows, columns, C) r, each channel over the wall's colour, in the photograph's unit; NaN
        where pixels are not used.
    unexplained, unexplained_by_any, noise_alone
        Standard deviation of r, of its part that no hidden image explains, and of the camera's
        noise alone, independent in the channels; over the photograph's root mean square.
    excess
        Energy of the blurred residual over that of noise; 1 for white noise.
    diagnosis
        Verdict on the scene.
    cost
        Error that such a misfit makes in an image, over that which noise leaves; None where A is
        too large or the image is black. With too few pixels with neighbours, `unexplained` is
        the only number.
    explained_by
        Fraction of a misfit that each remedy explains beyond chance; empty without a misfit.
    """

    light: Array = field(repr=False)
    unexplained: float
    unexplained_by_any: float | None
    noise_alone: float | None
    excess: float | None
    diagnosis: Diagnosis
    cost: float | None = None
    explained_by: Mapping[str, float] = field(default_factory=dict)

    @property
    def is_large(self) -> bool:
        """Whether the image leaves much more of the photograph than noise would."""
        over_photograph, over_noise = LARGE_UNEXPLAINED
        return self.unexplained > max(over_photograph, over_noise * (self.noise_alone or 0.0))

    @property
    def is_left(self) -> bool:
        """Whether the image leaves more light than noise and rounding would."""
        return self.unexplained > max(ROUNDED, LARGE_UNEXPLAINED[1] * (self.noise_alone or 0.0))

    @property
    def misfit(self) -> float:
        """Energy that neither an image nor noise explains, over the photograph's."""
        return (self.unexplained_by_any or 0.0) ** 2 - (self.noise_alone or 0.0) ** 2

    @property
    def is_smooth(self) -> bool:
        """Whether a misfit is smoother than noise, whatever it costs, and no rounding."""
        return (self.excess or 0.0) > EXCESS and (self.unexplained_by_any or 0.0) > ROUNDED

    @property
    def remedies(self) -> list[str]:
        """The remedies that help: more ``patches``, other ``numbers``, a photograph of ``paint``.

        Detail within patches passes for paint.
        """
        helping = [name for name, fraction in self.explained_by.items() if fraction > HELPS[name]]
        return [name for name in helping if name != "paint" or "patches" not in helping]

    def tried(self, name: str, light: Array, fit: Fit) -> "Residual":
        """Return the residual with the fraction of its misfit that light, (K, C, M'), explains."""
        if not self.misfit > 0:
            return self
        planes = np.moveaxis(self.light, -1, 0)
        z = fit.operator.unexplained(planes[:, np.isfinite(planes[0])].T)
        noise = np.sqrt(np.mean(z**2, axis=0))
        lit = noise > SINGLE_ROUNDING * noise.max()
        z, light = z[:, lit] / noise[lit], light[:, lit] / noise[lit, None]
        energy = float(np.sum(z**2)) * self.misfit / (self.unexplained_by_any or 1.0) ** 2
        explained = _by_numbers(z, light, fit) / energy
        return replace(self, explained_by={name: explained, **self.explained_by})

    def numbers(self) -> dict[str, Any]:
        """Return what a summary records, by name."""
        return {
            "unexplained": self.unexplained,
            "unexplained_by_any": self.unexplained_by_any,
            "noise_alone": self.noise_alone,
            "smooth_excess": self.excess,
            "misfit_cost": self.cost,
            "explained_by": dict(self.explained_by),
            "diagnosis": self.diagnosis,
        }


def residual_of(y: Array, signal: Array, fit: Fit, image: Any = None) -> Residual:
    """Return the residual of a photograph, y, (M', C), by a fit, from the signal A f̂, (M', C).

    The fit knows the rows and columns of photographs. Of the `image` f̂ it may know what errors of
    the scene do to light, the T_k, which only a misfit needs.
    """
    transport, place = fit.operator, fit.placed
    r = transport.project_out(y - signal)
    level = float(np.sqrt(np.mean(y**2))) or 1.0
    light, unexplained = _remainder(r, level, fit)

    random = np.random.default_rng(0).standard_normal((len(y), DRAWS))
    unexplicable = transport.unexplained(r)
    rest = place(unexplicable)
    white = place(transport.unexplained(random))
    differences = second_differences(rest)
    if np.count_nonzero(np.isfinite(differences[0])) < FEWEST or not np.nanmax(np.abs(differences)):
        return Residual(light, unexplained, None, None, None, "unknown")
    noise = _sizes(differences) / _sizes(second_differences(white)).mean()
    lit = noise > SINGLE_ROUNDING * noise.max()  # not a channel that is black
    excess = _blurred_energy(rest[lit] / noise[lit, None, None]) / _blurred_energy(white)
    own = np.sqrt(1 - _shared(differences[lit]))
    alone = float(own * np.sqrt(np.mean(noise**2))) / level
    kept = float(np.sqrt(np.nanmean(white**2))) or 1.0
    by_any = float(np.sqrt(np.nanmean(rest**2))) / kept / level
    shared = by_any <= MATERIAL * alone  # noise that channels share, as of rays, is noise
    sigma = float(np.sqrt(np.mean(noise**2))) if shared else alone * level
    cost = _cost(rest, white, transport, transport.project_out(signal), sigma, excess)
    is_noise = shared and excess <= EXCESS if cost is None else cost <= COSTLY
    diagnosis: Diagnosis = "fits" if by_any <= ROUNDED or is_noise else "does_not_fit"
    found = Residual(light, unexplained, by_any, alone, excess, diagnosis, cost)
    if cost is None or (diagnosis == "fits" and not found.is_smooth):
        return found
    z, w = unexplicable[:, lit] / noise[lit], y[:, lit] / noise[lit]
    energy = float(np.sum(z**2)) * max(found.misfit / by_any**2, SINGLE_ROUNDING)
    explained = {} if shared else {"paint": _by_paint(z, w, fit) / energy}
    if image is not None and (known := fit.motions(image)) is not None:
        known = known if fit.mixing is None else np.asarray(fit.mixing @ known)
        explained["numbers"] = _by_numbers(z, known[:, lit] / noise[lit, None], fit) / energy
    return replace(found, explained_by=explained)


def _by_numbers(z: Array, motions: Array, fit: Fit) -> float:
    """Return the energy of z that the numbers' light, (K, C, M'), explains beyond chance."""

    def explained(motions: Array) -> float:
        light = fit.unexplained(motions.reshape(-1, len(z))).reshape(len(motions), -1)
        slope = light @ z.T.ravel()
        return float(slope @ linalg.solve(light @ light.T + np.eye(len(light)), slope))

    rows, count = motions.reshape(-1, len(z)), len(motions)
    places = (moved(rows, k / ELSEWHERE, fit.mask) for k in range(1, ELSEWHERE))
    own, others = explained(motions), [explained(each.reshape(motions.shape)) for each in places]
    chance = float(np.mean(others))
    probability = special.fdtrc(count, count * len(others), own / (chance + 1e-30))
    return own - chance if float(probability) < BY_CHANCE else 0.0


def _by_paint(z: Array, w: Array, fit: Fit) -> float:
    """Return the energy of z that a fine factor of all light, w, explains beyond chance."""
    channels = z.shape[1]
    if channels == 1 or np.allclose(z, z[:, :1], rtol=1e-3):  # as many numbers as values
        return 0.0
    squares = np.sum(w**2, axis=1, keepdims=True)  # 0 of a black pixel
    factors = np.sum(w * z, axis=1, keepdims=True) / np.where(squares > 0, squares, np.inf)
    (factor,) = fit.placed(factors)
    fine = factor - ndimage.gaussian_filter(np.nan_to_num(factor), FINE, mode="nearest")
    paint = w * fine[np.isfinite(fine)][:, None]
    rest = np.sum((z - paint) ** 2) * channels / (channels - 1)
    return float(np.sum(z**2) - rest)


def quick_residual(y: Array, image: Any, noise: float, fit: Fit) -> Residual:
    """Return the residual of a photograph, y, (M', C), and a hidden image, without a verdict.

    It takes one product with A in single precision, as a live picture allows. `noise` is the
    camera's, over the photograph's mean.
    """
    signal = fit.operator.quick_light(fit.mixed(image))
    level = float(np.sqrt(np.mean(y**2))) or 1.0
    light, unexplained = _remainder(fit.operator.project_out(y - signal), level, fit)
    alone = noise * float(np.mean(y)) / level
    return Residual(light, unexplained, None, alone or None, None, "unknown")


def _remainder(r: Array, level: float, fit: Fit) -> tuple[Array, float]:
    """Return r, (M', C), in its place, (rows, columns, C), and its standard deviation."""
    freedom = max(len(r) - fit.operator.Q.shape[1], 1)
    unexplained = float(np.sqrt(np.sum(r**2) / (r.shape[1] * freedom))) / level
    return np.moveaxis(fit.placed(r), 0, -1), unexplained


def _cost(
    rest: Array, white: Array, A: TransportOperator, signal: Array, sigma: float, excess: float
) -> float | None:
    """Return the cost of a misfit, see `Residual`, from planes that no image explains.

    It is 0 where the misfit may be chance. The planes are (C, rows, columns), and those of white
    noise, (K, rows, columns), likewise; A is A⊥, and the signal A⊥ f̂, (M', C).
    """
    M, N = A.shape
    energy = float(np.sum(signal**2)) / signal.shape[1] / A.squared_norm
    if M * N**2 > LARGEST_GRAM or not (energy > 0 and sigma > 0):
        return None
    H = A.gram / sigma**2
    H[np.diag_indices(N)] += 1 / energy
    inverse = linalg.inv(H)
    used, shape = np.isfinite(rest[0]), rest.shape[1:]
    random = np.fft.rfft2(np.random.default_rng(0).standard_normal((SURROGATES, 1, *shape)))

    def errors(planes: Array) -> Array:
        """Return the mean square of what each plane does to an image, with random phases."""
        spectra = np.fft.rfft2(np.nan_to_num(planes)) * (random / np.abs(random))
        light = np.fft.irfft2(spectra, shape)[..., used].reshape(-1, M).T / sigma**2
        moved = np.mean((inverse @ A.rmatmat(light)) ** 2, axis=0)
        return np.asarray(moved.reshape(SURROGATES, -1).mean(axis=0))

    by_noise, by_misfit = sigma**2 * errors(white), errors(rest)
    more = float(by_misfit.mean() - by_noise.mean())
    if excess <= EXCESS and more <= CHANCE * float(by_noise.std()) / np.sqrt(len(by_misfit)):
        return 0.0
    return float(np.sqrt(max(more, 0.0) * N / np.trace(inverse)))


def _sizes(planes: Array) -> Array:
    """Return the root mean square of (K, rows, columns) planes; a median misses strong noise."""
    return np.asarray(np.sqrt(np.nanmean(planes**2, axis=(1, 2))))


def _blurred_energy(planes: Array) -> float:
    """Return the mean square of (K, rows, columns) planes after a blur, NaN counted as 0."""
    filled = np.nan_to_num(planes)
    blurred = ndimage.gaussian_filter(filled, (0, BLUR, BLUR), mode="constant")
    return float(np.mean(blurred[:, np.isfinite(planes[0])] ** 2))


def _shared(differences: Array) -> float:
    """Return the mean correlation of channels' differences; 0 if below, or of one channel."""
    values = differences.reshape(len(differences), -1)
    values = values[:, np.isfinite(values).all(axis=0)]
    correlations = np.atleast_2d(np.corrcoef(values))[np.triu_indices(len(values), 1)]
    if not correlations.size:
        return 0.0
    is_grey = np.isclose(correlations.max(), 1)
    return 0.0 if is_grey else max(float(correlations.mean()), 0.0)
