"""The settings of a laboratory: the scene's values, the light, the noise and the method."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass


@dataclass(frozen=True)
class Choice:
    """A laboratory's present settings.

    `values` are those of the scene's movable ``<default>``s, by name, which the method believes.
    `image` is the hidden image, a file or a shipped image, empty where it is unknown; `place` the
    place of ambient light, see `find_condition`, empty for none. For `sbr` and `snr` (dB) see
    `composite` and `add_noise`, for `method`, a name, `find_method`.
    """

    values: Mapping[str, float]
    image: str
    place: str = ""
    sbr: float = 0.5  # a bright room, in which a method must know ambient light
    snr: float = 60.0  # the paper's
    method: str = "noise-aware"
