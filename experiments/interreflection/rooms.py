"""Rooms whose surfaces send the monitor's light on, and what is shown in them."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

import periscopy_sim as ps
from periscopy_sim.rendering.transport.bounced_transport import add_bounces
from periscopy_sim.scenario import Scenario

Array = NDArray[np.float64]
SCENES = Path(__file__).parent / "scenes"


@dataclass(frozen=True)
class Workplace:
    """Where the page is written, and what is rendered once."""

    out: Path
    rendered: Path
    seed: int = 0

    def identity(self) -> bytes:
        """Return what tells these inputs from others."""
        return str(self.rendered).encode()


@dataclass(frozen=True)
class Room:
    """A scene, and what its monitor shows.

    Attributes
    ----------
    name
        In tables.
    scene
        Its file, or a shipped one's name.
    image
        Name of the shipped hidden image.
    small
        Values of the scene's ``<default>``s that make its photograph small.
    """

    name: str
    scene: str | Path
    image: str
    small: Mapping[str, int] = field(default_factory=dict)

    def at(self, hidden: tuple[int, int], *, small: bool = False) -> Scenario:
        """Return the scene."""
        return ps.load_scenario(self.scene, hidden, self.small if small else {})

    def shown(self, hidden: tuple[int, int]) -> Array:
        """Return what the monitor shows, (R, C, 3)."""
        return ps.read_hidden_image(ps.find_image(self.image), hidden)


BRIGHT = Room("bright room", "bright_room", "mushroom", {"resolution": 63})
ROOMS = (
    BRIGHT,
    Room("plant", "plant", "still_life", {"width": 72, "height": 56}),
    Room("side wall", SCENES / "side_wall.xml", "bars", {"resolution": 63}),
)


def photograph(scenario: Scenario, A: ps.BouncedTransport | Array, image: Array) -> Array:
    """Return A f with the wall's colour, (rows, columns, 3)."""
    seen = (A @ image.reshape(-1, 3)) * scenario.channel_gain
    return np.asarray(seen, np.float64).reshape(*scenario.photograph_shape, 3)


def both_matrices(
    scenario: Scenario, seed: int, *, samples: int = 16, pixel_samples: int = 1
) -> tuple[NDArray[np.float32], ps.BouncedTransport]:
    """Return the direct A and that of all bounces, of the same shadow rays."""
    direct = ps.render_transport(scenario, samples=samples, pixel_samples=pixel_samples, seed=seed)
    return direct, add_bounces(scenario, direct.copy(), None, seed=seed)
