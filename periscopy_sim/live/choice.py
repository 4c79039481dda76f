"""The settings of a laboratory: the scene's values, the light, the noise and the method."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

SBR = 0.5
"""Signal-to-background ratio at first: a bright room, in which a method must know ambient light."""

SNR = 60.0
"""Signal-to-noise ratio at first, in dB: the paper's."""


@dataclass(frozen=True)
class Choice:
    """A laboratory's present settings.

    Attributes
    ----------
    values
        Of the scene's movable ``<default>``s, by name, which the method believes.
    image
        The hidden image: a file, or a shipped image; empty where it is unknown.
    place
        The place of ambient light, see `find_condition`; empty for none.
    sbr, snr
        Signal-to-background ratio, and signal-to-noise ratio in dB; see `composite`, `add_noise`.
    method
        Its name, see `find_method`.
    """

    values: Mapping[str, float]
    image: str
    place: str
    sbr: float
    snr: float
    method: str
