"""The residual of one photograph: how large it is, what noise would leave, and what it may be."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy import linalg

from periscopy_sim.numerics.percentages import percentages
from periscopy_sim.reconstruction.large_scale.matrix_free import least_squares
from periscopy_sim.reconstruction.large_scale.transport_operator import TransportOperator
from periscopy_sim.reconstruction.residual.camera_noise import CameraNoise, camera_noise
from periscopy_sim.reconstruction.residual.causes import Cause, advice_for, likely_causes
from periscopy_sim.reconstruction.residual.encodings import (
    ENCODINGS,
    better_encoding,
    seen_recoded,
)
from periscopy_sim.reconstruction.residual.orientations import (
    FLIPPED,
    better_orientation,
    seen_flipped,
)
from periscopy_sim.reconstruction.residual.structure import Structure, structure_of

Array = NDArray[np.float64]

LARGEST_GRAM = 5e10
"""M N² up to which A⊥ᵀA⊥ is formed to tell what images explain: a second or two."""

RIDGE = 1e-8
"""Of its mean diagonal, added to it."""

PASSES = 12
"""Over a larger A: the weakest patterns stay in what is left, and with them no more than noise."""

DRAWS = 6
"""Draws of white noise that a residual is compared with."""

MATERIAL = 1.25
"""What no hidden image explains, over what noise alone would leave, from which a user is warned."""


ROUNDING = 1e-6
"""Of a photograph: what is left below it is rounding, of photographs in single precision too."""

SMOOTH_EXCESS = 1.5
"""Energy of a smoothed residual over that of noise, likewise. Bounced light that a true scene lacks
made 1.8, the ruler's errors of the tutorial 1.9: both are structure, and told."""


@dataclass(frozen=True, eq=False)
class Residual:
    """What a scene and a hidden image leave of a photograph.

    Attributes
    ----------
    light
        (rows, columns, 3) y − A f̂ − B ĉ, each channel over the wall's colour, in the photograph's
        unit; NaN where pixels are left out.
    unexplained
        Standard deviation of that, over the photograph's root mean square.
    noise_alone
        What white noise would leave instead, as neighbouring pixels tell it; None where too few
        pixels have neighbours.
    noise
        (3,) and its standard errors, in the unit of `light`; None likewise.
    structure
        How what no hidden image explains differs from white noise; None where that is not known.
    causes
        The likely ones, the largest first; empty where some hidden image explains the photograph
        but for noise.
    has_backgrounds
        Whether photographs with the monitor off were given: what they show is no cause any more.
    is_calibrated
        Whether the scene is known to be calibrated, as the command line tells of its file: then
        the advice is not to calibrate it, but to free more of it.
    better_orientation
        In which the scene explains the photograph much better, of `orientations.FLIPPED`; empty
        where it does in none.
    better_encoding
        What about the photograph's values, put right, would let the scene explain it much better,
        of `encodings.ENCODINGS`; empty where nothing would.
    """

    light: Array
    unexplained: float
    noise_alone: float | None
    noise: CameraNoise | None
    structure: Structure | None
    causes: tuple[Cause, ...]
    has_backgrounds: bool = False
    is_calibrated: bool = False
    better_orientation: str = ""
    better_encoding: str = ""

    @property
    def remark(self) -> str:
        """Return how much is unexplained, and how much noise alone would leave."""
        unexplained, alone = self._percentages
        told = f"unexplained: {unexplained} % of the photograph"
        return told if self.noise_alone is None else f"{told}; noise alone would leave {alone} %"

    @property
    def likeliest(self) -> str:
        """Return the name of the likeliest cause; empty where there is none."""
        return self.causes[0].name if self.causes else ""

    @property
    def warning(self) -> str:
        """Return that more than noise is left and its likely causes; empty where it is not."""
        other = self.better_orientation or self.better_encoding
        if not (self.causes or other) or self.noise_alone is None:
            return ""
        likely = advice_for(
            self.causes, has_backgrounds=self.has_backgrounds, is_calibrated=self.is_calibrated
        )
        unexplained, alone = self._percentages
        told = f"the scene leaves {unexplained} % of the photograph unexplained"
        if self.unexplained > self.noise_alone:
            told += f", where noise alone would leave {alone} %"
        smooth = self.structure
        if smooth is not None and smooth.excess > SMOOTH_EXCESS:
            told += (
                f"; blurred by a Gaussian of {smooth.scale:g} px it has "
                f"{smooth.excess:.{0 if smooth.excess >= 10 else 1}f} times "
                "the energy of noise"
            )
        if self.better_encoding:
            told += (
                f"; much less would be left if the photograph {self.better_encoding}: take it so"
            )
        if likely:
            told += f"; likely causes, the likeliest first: {likely}"
        if self.better_orientation:
            told += (
                f"; or the photograph came {self.better_orientation}: so much less would be left"
            )
        return told

    @property
    def _percentages(self) -> tuple[str, str]:
        """`unexplained` and `noise_alone` in percent; of a warning, until digits differ."""
        most = 4 if self.causes else 2
        return percentages(self.unexplained, self.noise_alone or 0.0, most)

    def told(self) -> dict[str, Any]:
        """Return the numbers that a summary keeps, by name."""
        found = self.structure
        return {
            "unexplained": self.unexplained,
            "noise_alone": self.noise_alone,
            "structured": None if found is None else found.is_found,
            "structure": None
            if found is None
            else {
                "probability_of_white_noise": found.probability,
                "scale_in_pixels": found.scale,
                "smoothed_energy_over_noise": found.excess,
                "alike_in_the_channels": found.common,
            },
            "likely_causes": {cause.name: cause.share for cause in self.causes},
            "better_orientation": self.better_orientation,
            "better_encoding": self.better_encoding,
        }


def residual_of(
    y: Array, signal: Array, transport: TransportOperator, place: Callable[[Array], Array]
) -> Residual:
    """Return the residual of a photograph y, (M', 3), of which a hidden image explains the signal.

    The signal is (M', 3), A f but for a gain over the wall; A⊥ is the transport. `place` puts
    (M', K) values into (K, rows, columns), NaN where pixels are left out.
    """
    left = transport.reject_background(y - signal)
    level = float(np.sqrt(np.mean(y**2))) or 1.0
    freedom = max(len(y) - transport.Q.shape[1], 1)
    unexplained = float(np.sqrt(np.sum(left**2) / (3 * freedom))) / level

    leave = left_by_images(transport)
    rng = np.random.default_rng(0)
    drawn = leave(transport.reject_background(rng.standard_normal((len(y), DRAWS))))
    planes, rest, white = place(left), place(leave(left)), place(drawn)
    found, fitted, taken = (camera_noise(each) for each in (place(y), rest, white[:3]))
    if found is None or fitted is None or taken is None:
        return Residual(np.moveaxis(planes, 0, -1), unexplained, None, None, None, ())
    # The scene may explain what neighbours differ by; it cannot make noise smaller, but for what
    # the fit takes from it.
    fitted = fitted.times(1 / float(taken.σ.mean()))
    noise = min(found, fitted, key=lambda each: float(np.sum(each.σ**2)))
    structure = structure_of(rest, white)
    if structure is not None and structure.grain > 0:
        noise = noise.times(np.sqrt(1 - structure.grain))
    alone = float(np.sqrt(np.mean(noise.σ**2))) / level
    causes: tuple[Cause, ...] = ()
    orientation = encoding = ""
    smooth = structure is not None and structure.is_found and structure.excess > SMOOTH_EXCESS
    # What another image would explain is the method's affair, not the scene's; noise, too, is
    # explained in part.
    kept = float(np.sqrt(np.nanmean(white**2))) or 1.0
    by_any = float(np.sqrt(np.nanmean(rest**2))) / kept / level
    if by_any > ROUNDING and alone > 0 and (by_any > MATERIAL * alone or smooth):
        used = np.isfinite(planes[0])

        def unexplained_light(light: Array) -> Array:
            return place(leave(transport.reject_background(light[:, used].T)))

        seen = place(y)
        others = seen_flipped(seen) | seen_recoded(seen)
        # At once: A is read through but twice.
        energies = np.nanmean(
            unexplained_light(np.concatenate([seen, *others.values()])) ** 2, axis=(1, 2)
        )
        excess = energies.reshape(-1, 3).sum(axis=1) - np.sum((kept * noise.σ) ** 2)
        left_so = dict(zip(others, excess[1:].tolist(), strict=True))
        causes = likely_causes(rest, seen, place(signal), kept * noise.σ, unexplained_light)
        orientation = better_orientation(
            float(excess[0]), {name: left_so[name] for name in FLIPPED if name in left_so}
        )
        encoding = better_encoding(float(excess[0]), {name: left_so[name] for name in ENCODINGS})
    light = np.moveaxis(planes, 0, -1)
    return Residual(
        light, unexplained, alone, noise, structure, causes, better_orientation=orientation,
        better_encoding=encoding,
    )  # fmt: skip


def left_by_images(transport: TransportOperator) -> Callable[[Array], Array]:
    """Return what gives the part of (M', K) light, range(B) projected out, beyond A⊥'s range."""
    pixels, patches = transport.shape
    if pixels * patches**2 > LARGEST_GRAM:

        def leave(light: Array) -> Array:
            end = least_squares(
                transport, transport.rmatmat(light), tolerance=1e-3, max_iterations=PASSES
            )
            return np.asarray(light - transport.matmat(end.f))

        return leave
    gram = transport.gram()
    gram[np.diag_indices_from(gram)] += RIDGE * np.trace(gram) / len(gram)
    factor = linalg.cho_factor(gram)
    return lambda light: np.asarray(
        light - transport.matmat(linalg.cho_solve(factor, transport.rmatmat(light)))
    )
