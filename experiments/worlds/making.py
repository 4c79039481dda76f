"""Photographs of hidden worlds by plain Mitsuba, which knows nothing of the package's matrices."""

from collections.abc import Mapping
from dataclasses import dataclass, field
from pathlib import Path

import numpy as np

import periscopy_sim as ps
from periscopy_sim.numerics import Array
from periscopy_sim.rendering.variant import mi
from periscopy_sim.storage.rasters import write_exr

SCENES = Path(__file__).with_name("scenes")

SNR, SBR = 60.0, 1.0

SAMPLES, PASSES = 1024, 8
"""Paths to a pixel, of 16 shadow rays each, and renderings that are averaged."""


@dataclass(frozen=True)
class World:
    """A scene that is photographed, the one that its reconstruction assumes, and what it shows.

    Attributes
    ----------
    photographed, assumed
        Files under `SCENES`.
    shown
        The shipped picture, and (R, C), that each bitmap of the photographed scene shows, by its
        parameter; the hidden surface of the assumed scene is called ``hidden_PARAMETER``.
    lit_by
        Parameters of the assumed scene that light the card there, if one does: its radiance, seen
        by the sensor ``card_camera``, is the truth.
    """

    photographed: str
    assumed: str
    shown: Mapping[str, tuple[str, tuple[int, int]]]
    lit_by: Mapping[str, str] = field(default_factory=dict)

    def truth(self, folder: Path) -> dict[str, Array]:
        """Return what the hidden surfaces send, (R, C, 3), by parameter; largest value 1 if lit."""
        shown = {
            name: ps.read_hidden_image(ps.find_image(picture), shape)
            for name, (picture, shape) in self.shown.items()
        }
        if self.lit_by:
            prints = {name: bitmap(folder / f"{name}.exr", each) for name, each in shown.items()}
            card = renderings(
                SCENES / self.assumed, 0, sensor="card_camera", **prints, **self.lit_by
            )
            shown = {name: card.mean(axis=0) / card.mean(axis=0).max() for name in shown}
        return shown

    def photograph(
        self, folder: Path, truth: Mapping[str, Array], seed: int
    ) -> tuple[Array, float]:
        """Return a photograph at the SBR and SNR, and the error of its rendering over the noise."""
        scene, black = SCENES / self.photographed, np.zeros((2, 2, 3))
        bright = {name: bitmap(folder / f"{name}.exr", each) for name, each in truth.items()}
        dark = {name: bitmap(folder / "black.exr", black) for name in truth}
        signals = renderings(scene, seed, **bright)
        ambient = renderings(scene, seed + PASSES, **dark, room_light="1").mean(axis=0)
        signal = signals.mean(axis=0)
        whole = ps.composite(signal, ambient, SBR)
        noisy = ps.add_noise(whole, SNR, seed)
        share = SBR / (1 + SBR) / signal.mean()
        error = share * np.sqrt(signals.var(axis=0, ddof=1).mean() / PASSES)
        return noisy, float(error / (noisy - whole).std())


SCREEN = (18, 24)

WORLDS = {
    "two cards, 0.1 m apart in depth": World(
        "cards.xml",
        "cards.xml",
        {"rear": ("mushroom", (15, 10)), "front": ("still_life", (15, 10))},
    ),
    "a curved screen": World("curved.xml", "curved.xml", {"screen": ("mushroom", SCREEN)}),
    "a card that a lamp lights": World(
        "glow.xml", "lit.xml", {"card": ("still_life", SCREEN)}, {"spot_light": "1"}
    ),
    "a scene outside a window": World("window.xml", "window.xml", {"outside": ("sunset", SCREEN)}),
    "a frosted window": World("pane.xml", "pane.xml", {"outside": ("sunset", SCREEN)}),
    "the scene outside, taken for a frosted window": World(
        "window.xml", "pane.xml", {"outside": ("sunset", SCREEN)}
    ),
    "two cards, 0.5 and 1 m behind a door": World(
        "doorway.xml",
        "doorway.xml",
        {"near": ("mushroom", (15, 10)), "far": ("still_life", (15, 10))},
    ),
}


def renderings(
    scene: Path,
    seed: int,
    *,
    sensor: str = "camera",
    passes: int = PASSES,
    samples: int = SAMPLES,
    **parameters: str,
) -> Array:
    """Return renderings by `mi.render`, (passes, rows, columns, 3), as a sensor sees them."""
    ps.use_variant()
    world = mi.load_file(str(scene), **parameters)
    (camera,) = (each for each in world.sensors() if each.id() == sensor)
    each = (mi.render(world, sensor=camera, spp=samples, seed=seed + k) for k in range(passes))
    return np.stack([np.array(picture, np.float64) for picture in each])


def bitmap(file: Path, image: Array) -> str:
    """Write an image as a bitmap, whose first row Mitsuba takes for v = 0; return its path."""
    file.parent.mkdir(parents=True, exist_ok=True)
    write_exr(file, np.ascontiguousarray(image[::-1]), {})
    return str(file.resolve())
