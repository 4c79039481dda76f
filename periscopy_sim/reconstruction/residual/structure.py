"""Whether a residual is white noise, or has more energy at low frequencies.

Smoothed by a Gaussian, white noise keeps a known part of its energy. Compared are the residual's
smoothed energy and the energy of its differences (`camera_noise`), which hold the high frequencies.
What a fit takes from a photograph it takes at low frequencies; so the ratio of the two is taken
over that of drawn white noise which went through the same fit. Without structure it is nearly of
Fisher's distribution, whatever the noise's size.

The noise of the channels is independent, what paint, geometry or light do to a photograph is not.
So a smoothed residual that is alike in the channels is no noise, not even one that a rectification
has smeared over neighbouring pixels.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy import ndimage, special

from periscopy_sim.reconstruction.residual.camera_noise import SHARED, neighbour_differences_of

Array = NDArray[np.float64]

SCALES = (1.0, 2.0, 4.0, 8.0, 16.0)
"""Standard deviations of the Gaussians, in pixels."""

FEWEST = 6.0
"""Degrees of freedom of a smoothed channel below which a scale is left out."""

ERROR_RATE = 1e-3
"""Part, at most, of white residuals that are taken for structured; likewise for what is common."""

COPIES = 1 - 1e-6
"""Correlation of two channels' differences from which they are taken for copies of one."""

GRAIN = 0.5
"""Mean correlation of the channels' differences from which they are taken for the wall's."""


@dataclass(frozen=True, eq=False)
class Structure:
    """How a residual differs from white noise."""

    probability: float  # that white noise has as much energy at any of the low frequencies
    scale: float  # pixels: standard deviation of the Gaussian after which it differs most
    excess: float  # the smoothed energy at this scale over that of white noise
    likeness: float | None  # mean correlation of two channels, smoothed thus; None of copies
    common: bool  # whether that is more than noise that is independent in the channels has
    grain: float  # part of the differences of neighbours, alike in the channels, that is no noise

    @property
    def is_found(self) -> bool:
        """Whether the residual is no white noise."""
        return self.probability < ERROR_RATE or self.grain > 0


def structure_of(residual: Array, white: Array) -> Structure | None:
    """Test a residual, (3, rows, columns), NaN where pixels are left out.

    It is compared with white noise of variance 1, (K, rows, columns), NaN likewise, from which the
    same fit has taken what it takes. None where too few pixels have neighbours, or nothing at all
    is left.
    """
    used = np.asarray(np.isfinite(residual).all(axis=0))
    fine = neighbour_differences_of(residual)
    inside = np.isfinite(fine).all(axis=0)
    freedom = int(inside.sum()) / SHARED
    if freedom < FEWEST:
        return None
    fine = fine[:, inside]
    energy = np.mean(fine**2, axis=1)
    if not (energy > 0).all():
        return None
    alike = _correlations(fine)
    channels = 9 / float(np.sum(alike**2))  # independent ones
    share = len(white) / (len(white) + channels)  # of the comparison's variance, the residual's own
    noise = float(np.mean(neighbour_differences_of(white)[:, inside] ** 2))
    light, drawn = (np.where(used, planes, 0) for planes in (residual, white))
    tests = []
    for scale in SCALES:
        unprojected, own_freedom = _white(used, scale)
        expected = float(np.mean(np.sum(_smoothed(drawn, scale)[:, used] ** 2, axis=1))) / noise
        own_freedom *= expected / unprojected
        if own_freedom < FEWEST:
            break
        smooth = _smoothed(light, scale)[:, used]
        excess = float(np.mean(np.sum(smooth**2, axis=1) / energy)) / expected
        freedoms = (channels * share * each for each in (own_freedom, freedom))
        probability = float(special.fdtrc(*freedoms, excess))
        likeness = float(_correlations(smooth)[np.triu_indices(3, 1)].mean())
        tests.append((probability, scale, excess, likeness, own_freedom))
    if not tests:
        return None
    probability = min(1.0, len(tests) * min(test[0] for test in tests))
    _, scale, excess, likeness, own = max(tests, key=lambda test: (test[2] - 1) * np.sqrt(test[4]))
    if alike[np.triu_indices(3, 1)].max() > COPIES:
        return Structure(probability, scale, excess, None, common=False, grain=0.0)
    chance = float(special.ndtri(1 - ERROR_RATE)) / np.sqrt(3 * own)
    grain = float(alike[np.triu_indices(3, 1)].mean())
    grain = grain if grain > GRAIN else 0.0
    return Structure(probability, scale, excess, likeness, bool(likeness > chance), grain)


def _correlations(planes: Array) -> Array:
    """Return the correlations of (K, m) values, (K, K)."""
    products = planes @ planes.T
    sizes = np.sqrt(np.diag(products)) + 1e-300
    return np.asarray(products / np.outer(sizes, sizes))


def _smoothed(planes: Array, scale: float) -> Array:
    return np.asarray(
        ndimage.gaussian_filter(planes, (0, scale, scale), mode="constant", truncate=4)
    )


def _white(used: NDArray[np.bool_], scale: float) -> tuple[float, float]:
    """Return the energy of smoothed white noise of variance 1 in the pixels used, and its freedom.

    The freedom is that of the χ² distribution of as large a relative variance.
    """
    reach = int(4 * scale + 0.5)
    kernel = np.zeros(4 * reach + 1)
    kernel[2 * reach] = 1
    kernel = ndimage.gaussian_filter1d(kernel, scale, mode="constant", truncate=4)
    squares = kernel[reach : 3 * reach + 1] ** 2
    field = used.astype(np.float64)
    for axis in (0, 1):
        field = ndimage.convolve1d(field, squares, axis=axis, mode="constant")
    expected = float(field[used].sum())
    shared = float(np.sum(np.convolve(kernel, kernel) ** 2)) ** 2
    return expected, expected**2 / (shared * int(used.sum()))
