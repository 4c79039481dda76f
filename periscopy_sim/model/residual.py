"""The residual of one photograph: how large it is, what noise would leave, and whether it fits.

    r = y − A f̂ − B ĉ

Part of r another hidden image would explain, which is the method's affair, not the scene's. So r is
judged by what no image explains of it, against white noise from which the same fit has taken what
it takes. Blurred, white noise keeps a known part of its energy; misplaced geometry, bounced light
and vignetting are smooth and keep more. Uneven paint is as white as noise, and alike in all
channels, which a camera's noise is not.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import Any, Literal

import numpy as np
from numpy.typing import NDArray
from scipy import ndimage

from periscopy_sim.model.noise import camera_noise, second_differences
from periscopy_sim.model.transport_operator import TransportOperator

Array = NDArray[np.float64]
Diagnosis = Literal["fits", "does_not_fit", "uneven_paint", "not_linear", "unknown"]
"""What a residual says of the scene; ``unknown`` where too few pixels have neighbours."""

DRAWS = 6
"""Draws of white noise, a multiple of the three channels."""

BLUR = 2.0
"""Standard deviation in pixels of the Gaussian that parts smooth errors from noise."""

EXCESS = 3.0
"""Energy of a blurred residual over that of noise, above which the scene does not fit. The true
scene of a chair with an A of 16 rays a patch made 1.4 to 2.2 (29 x 36 patches; with 9 x 11 the
rays' own noise makes 3 to 9), the real chair photograph 31."""

MATERIAL = 1.25
"""Unexplained light over what noise alone would leave, above which the scene does not fit."""

SHARED = 0.5
"""Mean correlation of the channels' differences of neighbours, above which they are the wall's."""

COPIES = 1 - 1e-6
"""Correlation of two channels from which they are copies of one, as in a grey photograph."""

GAMMA = 2.2
"""Exponent that decodes sRGB within some percent."""

BETTER = 0.5
"""Fraction of the unexplained energy below which another encoding explains the photograph: encoded
photographs kept 0.01 to 0.20 of it once decoded, linear ones at least 0.65."""

ROUNDING = 1e-6
"""Unexplained fraction of a photograph that is rounding."""


@dataclass(frozen=True, eq=False)
class Residual:
    """What a scene and a hidden image leave of a photograph.

    Attributes
    ----------
    light
        (rows, columns, 3) r, each channel over the wall's colour, in the photograph's unit; NaN
        where pixels are not used.
    unexplained
        Standard deviation of r over the photograph's root mean square.
    unexplained_by_any
        The same of what no hidden image explains; None where too few pixels have neighbours.
    noise_alone
        What the camera's noise alone would leave; None likewise.
    excess
        Energy of the blurred residual over that of noise; 1 for white noise, None likewise.
    diagnosis
        What the residual says of the scene.
    """

    light: Array
    unexplained: float
    unexplained_by_any: float | None
    noise_alone: float | None
    excess: float | None
    diagnosis: Diagnosis

    def numbers(self) -> dict[str, Any]:
        """Return what a summary records, by name."""
        return {
            "unexplained": self.unexplained,
            "unexplained_by_any": self.unexplained_by_any,
            "noise_alone": self.noise_alone,
            "smooth_excess": self.excess,
            "diagnosis": self.diagnosis,
        }


def residual_of(
    y: Array,
    signal: Array,
    transport: TransportOperator,
    place: Callable[[Array], Array],
    uncorrected: Array | None = None,
) -> Residual:
    """Return the residual of a photograph.

    Parameters
    ----------
    y
        (M', 3) the photograph in the pixels used.
    signal
        (M', 3) the light A f̂ of the hidden image.
    transport
        A⊥.
    place
        Puts (M', K) values into (K, rows, columns), NaN where pixels are not used.
    uncorrected
        (M', 3) the photograph before corrections, of which other encodings are tried; None for y.
    """
    r = transport.project_out(y - signal)
    level = float(np.sqrt(np.mean(y**2))) or 1.0
    freedom = max(len(y) - transport.Q.shape[1], 1)
    unexplained = float(np.sqrt(np.sum(r**2) / (3 * freedom))) / level
    light = np.moveaxis(place(r), 0, -1)

    random = np.random.default_rng(0).standard_normal((len(y), DRAWS))
    rest = place(transport.unexplained(r))
    white = place(transport.unexplained(random))
    noise, of_white = camera_noise(rest), camera_noise(white)
    if noise is None or of_white is None or not noise.all():
        return Residual(light, unexplained, None, None, None, "unknown")
    noise = noise / of_white.mean()
    alike = _correlations(second_differences(rest))
    is_paint = alike.mean() > SHARED and alike.max() < COPIES
    excess = _blurred_energy(rest / noise[:, None, None]) / _blurred_energy(white)
    alone = float(np.sqrt(np.mean(noise**2))) / level
    kept = float(np.sqrt(np.nanmean(white**2))) or 1.0
    by_any = float(np.sqrt(np.nanmean(rest**2))) / kept / level
    diagnosis: Diagnosis = "fits"
    if by_any > ROUNDING and (excess > EXCESS or by_any > MATERIAL * alone):
        diagnosis = "does_not_fit"
        given = y if uncorrected is None else uncorrected
        codes = np.hstack([given, _recoded(given, GAMMA), _recoded(given, 1 / GAMMA)])
        energies = np.sum(transport.unexplained(codes) ** 2, axis=0)
        linear, *others = energies.reshape(3, 3).sum(axis=1)
        if min(others) < BETTER * linear:
            diagnosis = "not_linear"
    elif is_paint and by_any > ROUNDING:
        diagnosis = "uneven_paint"
    if is_paint:
        alone *= float(np.sqrt(1 - alike.mean()))
    return Residual(light, unexplained, by_any, alone, excess, diagnosis)


def _blurred_energy(planes: Array) -> float:
    """Return the mean square of (K, rows, columns) planes after a blur, NaN counted as 0."""
    filled = np.nan_to_num(planes)
    blurred = ndimage.gaussian_filter(filled, (0, BLUR, BLUR), mode="constant")
    return float(np.mean(blurred[:, np.isfinite(planes[0])] ** 2))


def _correlations(differences: Array) -> Array:
    """Return the correlations of three channels' differences, pair by pair, (3,)."""
    values = differences.reshape(3, -1)
    values = values[:, np.isfinite(values).all(axis=0)]
    correlations = np.asarray(np.corrcoef(values))
    return np.asarray(correlations[np.triu_indices(3, 1)])


def _recoded(y: Array, gamma: float) -> Array:
    """Return (M', 3) light raised to a power, scaled so that its mean changes as fast as before."""
    means = np.abs(y.mean(axis=0)) + 1e-300
    return np.asarray(means / gamma * np.sign(y) * np.abs(y / means) ** gamma)
