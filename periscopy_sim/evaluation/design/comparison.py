"""Under which light and noise scenes are compared.

Scenes differ in how much light they send to the wall, and nothing may be won by units alone. Two
comparisons are fair. At an equal level each photograph is exposed to the same mean, as a
photographer would: the SNR and the SBR are the same for all. In equal time the room and the
camera's exposure are those of the scene as it stands: its ambient light stays, the monitor's light
is more or less, and so are both SBR and SNR, photons being what limits it. In both the sensor is
the same: the electrons of a whole photograph are counted, however many pixels share them.
"""

from __future__ import annotations

from dataclasses import dataclass
from enum import StrEnum
from typing import Any

import numpy as np
from numpy.typing import NDArray

from periscopy_sim.errors import PeriscopyError
from periscopy_sim.measurement import noise_level

Array = NDArray[np.float64]
Image = NDArray[np.floating[Any]]


class By(StrEnum):
    """What ranks the points: the names of these numbers of a `Merit` follow."""

    bound = "bound"
    told = "told"
    time = "time"

    @property
    def number(self) -> str:
        """The number of a merit."""
        names = {By.bound: "bound", By.told: "told_error", By.time: "exposure_time"}
        return names[self]


class Equal(StrEnum):
    """What all scenes of a comparison have in common."""

    level = "level"
    time = "time"


@dataclass(frozen=True)
class Comparison:
    """The noise and the ambient light of photographs.

    Attributes
    ----------
    snr
        Signal-to-noise ratio in dB of a photograph of the scene as it stands.
    sbr
        Its signal-to-background ratio; infinite where there is no ambient light.
    equal
        What all scenes have in common, see the module.

    Raises
    ------
    PeriscopyError
        If the SNR is not finite, or the SBR not positive.
    """

    snr: float = 60.0
    sbr: float = 0.5
    equal: Equal = Equal.level

    def __post_init__(self) -> None:
        if not np.isfinite(self.snr):
            raise PeriscopyError(f"the SNR must be a finite number of dB, not {self.snr}")
        if not self.sbr > 0:
            raise PeriscopyError(f"the SBR must be positive, or inf without any, not {self.sbr}")

    @property
    def has_ambient_light(self) -> bool:
        """Whether there is any."""
        return bool(np.isfinite(self.sbr))

    def measured(
        self, signal: Image, light: Image, reference: float, pixels: float = 1.0
    ) -> tuple[Array, float]:
        """Add ambient light to a photograph, and tell its noise.

        Parameters
        ----------
        signal
            (M, channels) what the monitor sends, in any unit.
        light
            (M, channels) ambient light of mean 1.
        reference
            Mean of the signal of the scene as it stands, in the same unit.
        pixels
            Those of the photograph over those of the scene as it stands.

        Returns
        -------
        photograph, σ
            (M, channels), in the signal's unit, and the standard deviation of its noise.
        """
        alike = float(signal.mean()) if self.equal is Equal.level else reference
        photograph = np.asarray(signal + light * (alike / self.sbr), np.float64)
        electrons = 1.0  # over those of the scene as it stands
        if self.equal is Equal.time:
            electrons = float(photograph.mean()) / (reference * (1 + 1 / self.sbr))
        return photograph, noise_level(photograph, self.snr) * float(np.sqrt(pixels / electrons))
