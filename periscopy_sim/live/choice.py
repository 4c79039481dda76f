"""What a person has set: the scene's values, the light, the noise and the method."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

SBR = 0.5
"""Signal-to-background ratio at first: a bright room, in which a method must know ambient light."""

SNR = 60.0
"""Signal-to-noise ratio at first, in dB: the paper's."""


@dataclass(frozen=True)
class Choice:
    """A laboratory as it is set now.

    Attributes
    ----------
    values
        Of the scene's ``<default>``s that can be moved, by name; what the method believes.
    image
        What the monitor shows: a file, or a shipped image; empty where nobody knows.
    place
        Where ambient light comes from, see `find_condition`; empty for none.
    sbr, snr
        Signal-to-background ratio, and signal-to-noise ratio in dB; see `composite`, `add_noise`.
    method
        Its name, see `find_method`.
    taken
        The values with which a synthetic photograph was taken, where it stays as it is while the
        scene moves; None where it is taken anew.
    """

    values: Mapping[str, float]
    image: str
    place: str
    sbr: float
    snr: float
    method: str
    taken: Mapping[str, float] | None = None
