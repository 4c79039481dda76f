"""What learned methods are tried on: photographs like those they learned from, and others.

Hidden images are crops of photographs that no network has seen, shipped drawings, or patterns of
statistics that no photograph has. Numbers of the chair are drawn from the training's own ranges.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

import periscopy_sim as ps
from experiments.learned import pictures
from experiments.learned.samples import HIDDEN, told_values
from experiments.setting import Setting
from periscopy_sim.scenario import Scenario
from periscopy_sim.storage.formats.srgb import srgb_decode
from periscopy_sim.storage.pictures import area_average

Array = NDArray[np.float64]

CROPS, DRAWINGS, PATTERNS = "crops", "drawings", "patterns"


@dataclass(frozen=True)
class Condition:
    """Photographs of one kind.

    Attributes
    ----------
    name
        What is not as in the training.
    images
        `CROPS`, `DRAWINGS` or `PATTERNS`.
    scene
        A shipped scene; of the chair, each geometry is drawn.
    light
        Ambient light: a shipped place, or lamps as in the training where empty.
    ruler
        Errors of the scene that methods are told, over those that the scene declares.
    sbr, snr
        Signal-to-background ratio, and signal-to-noise ratio in dB.
    """

    name: str
    images: str = CROPS
    scene: str = "chair"
    light: str = ""
    ruler: float = 0.0
    sbr: float = 0.5
    snr: float = 60.0


CONDITIONS = (
    Condition("as trained"),
    Condition("drawings", images=DRAWINGS),
    Condition("patterns", images=PATTERNS),
    Condition("a plate for the chair", scene="plate"),
    Condition("a plant for the chair", scene="plant"),
    Condition("half the ruler's errors", ruler=0.5),
    Condition("the ruler's errors", ruler=1.0),
    Condition("overcast sky", light="overcast"),
    Condition("window", light="window_left"),
    Condition("stained glass", light="stained_glass"),
    Condition("SBR 0.05", sbr=0.05),
    Condition("noise at 40 dB", snr=40.0),
)


@dataclass(frozen=True, eq=False)
class Trial:
    """One geometry: what methods are told, and photographs with their truths, by image."""

    scenario: Scenario
    photographs: Mapping[str, Array]
    truths: Mapping[str, Array]


def trial(condition: Condition, number: int, setting: Setting) -> Trial:
    """Draw and render a geometry of a condition."""
    rng = np.random.default_rng([7, number])
    values = chair_values(rng) if condition.scene == "chair" else {}
    if condition.light:
        values.pop("camera_dx", None)  # the place is rendered for the camera as it stands
    there = ps.load_scenario(condition.scene, HIDDEN, values)
    told = values
    if condition.ruler:
        told = told_values(values, condition.ruler, rng)
    A = ps.render_transport(there, pixel_samples=4, seed=1)
    photographs, truths = {}, {}
    for name, truth in hidden_images(condition.images, rng):
        signal = (A @ truth.reshape(-1, 3)).reshape(*there.photograph_shape, 3)
        if condition.light:
            ambient = setting.backgrounds([condition.light])[condition.light]
        else:
            ambient = lamps(ps.point_light_backgrounds(there), there, rng)
        exposed = ps.composite(signal, ambient, condition.sbr)
        photographs[name] = ps.add_noise(exposed, condition.snr, int(rng.integers(2**31)))
        truths[name] = truth
    return Trial(ps.load_scenario(condition.scene, HIDDEN, told), photographs, truths)


def chair_values(rng: np.random.Generator) -> dict[str, float]:
    """Draw a chair as the training data has it."""
    given = ps.load_configuration(Path(__file__).with_name("training.yaml"))
    drawn = given.scenes[0].parameters
    return {name: float(each.draw(rng)) for name, each in drawn.items()}


def lamps(B: Array, scenario: Scenario, rng: np.random.Generator) -> Array:
    """Draw three coloured lamps of those that Eq. 4 puts about the wall; (rows, columns, 3)."""
    chosen = B[:, rng.choice(B.shape[1], 3, replace=False)]
    light: Array = chosen @ rng.uniform(0.3, 1, (3, 3))
    return light.reshape(*scenario.photograph_shape, 3)


def hidden_images(kind: str, rng: np.random.Generator) -> Iterator[tuple[str, Array]]:
    """Draw hidden images of a kind, (R, C, 3), linear in [0, 1], by their names."""
    if kind == CROPS:
        for name in pictures.WITHHELD:
            part = pictures.crop(pictures.photograph(name), rng)
            yield name, area_average(srgb_decode(part), HIDDEN)
    elif kind == DRAWINGS:
        for name in ("mushroom", "digits", "siemens"):
            yield name, ps.read_hidden_image(ps.find_image(name), HIDDEN)
    else:
        yield "noise", rng.random((*HIDDEN, 3))
        yield "stars", (rng.random((*HIDDEN, 1)) < 0.02) * rng.uniform(0.5, 1, (*HIDDEN, 3))
        rows, columns = np.indices(HIDDEN)
        colour = rng.uniform(0.4, 1, 3)
        yield "checks of two patches", ((rows // 2 + columns // 2) % 2)[..., None] * colour
