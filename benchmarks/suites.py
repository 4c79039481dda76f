"""The frozen suites: which scenes, hidden images, light and noise methods are compared on.

Nothing here is fitted to a method. All that moves a number is in `definition`, whose digest
``frozen.json`` keeps beside `VERSION`: a test fails where one changes without the other.
"""

from __future__ import annotations

import hashlib
import json
from collections.abc import Mapping
from dataclasses import asdict, dataclass, field
from functools import cache
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from periscopy_sim.shipped import find_image, find_scene
from periscopy_sim.storage.provenance import scene_sha256

VERSION = "1"
"""Raise it with every change that moves a number, then run `python -m benchmarks freeze`."""

FROZEN = Path(__file__).parent / "frozen.json"
"""Version, digest of the definition, and what the photographs and metrics come to."""

_NUMBERS_COME_FROM = ("suites.py", "cases.py", "scoring.py")

_PLACES: dict[str, tuple[float, float]] = {
    "occluder_dx": (-0.03, 0.03),
    "occluder_dy": (-0.04, 0.04),
    "occluder_dz": (-0.03, 0.03),
    "monitor_dx": (-0.02, 0.02),
    "monitor_dz": (-0.02, 0.02),
}
_SIZES: dict[str, tuple[float, float]] = {
    "seat_width": (0.06, 0.09),
    "seat_depth": (0.06, 0.09),
    "back_height": (0.055, 0.095),
    "leg_width": (0.01, 0.02),
    "occluder_turn": (-25, 25),
}
_RULER = {
    "occluder_dx": 0.003,
    "occluder_dy": 0.003,
    "occluder_dz": 0.003,
    "monitor_dx": 0.003,
    "monitor_dz": 0.003,
    "occluder_turn": 0.5,
}


@dataclass(frozen=True)
class Suite:
    """Photographs that methods are compared on; a cell is one geometry, image, light and ratio.

    Attributes
    ----------
    name, about
        Short name, and what it tries, in a sentence.
    seed
        Of geometries, crops and noise.
    geometries
        How many. Each is drawn by the seed: none is a shipped scene as it stands.
    hidden
        (rows, columns) of the hidden image.
    images
        Hidden images: names of shipped ones, or ``crop:NAME``, a crop of scikit-image's picture.
    lights
        Shipped places of ambient light; which of their flips is drawn for each geometry.
    ratios
        Signal-to-background ratios.
    ranges
        Numbers of the scene that are drawn, between two values each.
    errors
        Standard deviations by which the scene that methods are told differs from the true one.
    frames
        Frames of a moving scene in the place of images; 0 for stills.
    scene, snr
        Shipped scene, and signal-to-noise ratio in dB.
    """

    name: str
    about: str
    seed: int
    geometries: int
    hidden: tuple[int, int]
    images: tuple[str, ...]
    lights: tuple[str, ...]
    ratios: tuple[float, ...]
    ranges: Mapping[str, tuple[float, float]] = field(default_factory=lambda: _PLACES | _SIZES)
    errors: Mapping[str, float] = field(default_factory=dict)
    frames: int = 0
    scene: str = "chair"
    snr: float = 60.0


_STILL = ("mushroom", "still_life", "crop:astronaut", "crop:coffee")

_ALL = (
    Suite(
        "still",
        "36 x 29 patches under realistic light as bright as twice the monitor's.",
        1, 6, (29, 36), _STILL, ("overcast",), (0.5,),
    ),
    Suite(
        "fine",
        "Four times as many patches, 72 x 58.",
        2, 2, (58, 72), ("letters", "crop:chelsea"), ("overcast",), (0.5,),
    ),
    Suite(
        "low-sbr",
        "Ambient light 10 and 20 times as bright as the monitor's.",
        3, 4, (29, 36), ("mushroom", "crop:coffee"), ("ceiling_panels",), (0.1, 0.05),
    ),
    Suite(
        "wrong-geometry",
        "Methods are told a scene that a ruler got wrong: 3 mm in each direction, half a degree.",
        4, 5, (29, 36), ("mushroom", "bars", "crop:astronaut"), ("overcast",), (0.5,),
        errors=_RULER,
    ),
    Suite(
        "adversarial-light",
        "Light with edges as sharp as the penumbrae's: stained glass, sun on snow.",
        5, 3, (29, 36), ("mushroom", "crop:chelsea"), ("stained_glass", "snow"), (0.5, 0.1),
    ),
    Suite(
        "video",
        "A ball that bounces past a waving flag, 16 frames a second.",
        6, 2, (29, 36), (), ("overcast",), (0.5,), frames=10,
    ),
)  # fmt: skip

SUITES: Mapping[str, Suite] = {suite.name: suite for suite in _ALL}
"""The suites by name."""


@dataclass(frozen=True)
class Geometry:
    """One drawn geometry: values of the scene's ``<default>``s, in metres and degrees.

    Attributes
    ----------
    true, told
        As it is, and as the methods are told.
    flips
        Axes of the photograph, 0 and 1, along which each light is turned over.
    """

    true: Mapping[str, float]
    told: Mapping[str, float]
    flips: tuple[int, ...]


def geometry(suite: Suite, number: int) -> Geometry:
    """Draw a suite's geometry; it depends on the suite's seed and the number alone."""
    rng = np.random.default_rng([suite.seed, number])
    true = {name: round(float(rng.uniform(*span)), 6) for name, span in suite.ranges.items()}
    wrong = {name: float(rng.normal(0, error)) for name, error in suite.errors.items()}
    told = {name: round(value + wrong.get(name, 0.0), 6) for name, value in true.items()}
    flips = tuple(axis for axis in (0, 1) if rng.random() < 0.5)
    return Geometry(true, told, flips)


@cache
def picture(name: str) -> NDArray[np.uint8]:
    """Return a picture of scikit-image's wheel, (rows, columns, 3) in sRGB; nothing is fetched."""
    from skimage import data

    pixels: NDArray[np.uint8] = getattr(data, name)()
    return pixels


def crop(suite: Suite, name: str) -> NDArray[np.uint8]:
    """Draw a suite's crop of a picture, with the sides of the hidden image's patches."""
    pixels = picture(name)
    rng = np.random.default_rng([suite.seed, *name.encode()])
    rows, columns = suite.hidden
    height = int(min(pixels.shape[0], pixels.shape[1] * rows / columns) * rng.uniform(0.5, 0.9))
    width = height * columns // rows
    top = int(rng.integers(pixels.shape[0] - height + 1))
    left = int(rng.integers(pixels.shape[1] - width + 1))
    return pixels[top : top + height, left : left + width]


def definition() -> dict[str, Any]:
    """Return all that moves a number: values drawn, digests of scenes, images and of the code."""
    return {"suites": [_definition(suite) for suite in _ALL], "code": _code()}


def digest() -> str:
    """Return the SHA-256 of the definition: the same on every machine."""
    text = json.dumps(definition(), sort_keys=True)
    return hashlib.sha256(text.encode()).hexdigest()


def _definition(suite: Suite) -> dict[str, Any]:
    drawn = [asdict(geometry(suite, number)) for number in range(suite.geometries)]
    scenes = (suite.scene, *(f"ambient/{light}" for light in suite.lights))
    return {
        **asdict(suite),
        "drawn": drawn,
        "scenes": {name: scene_sha256(find_scene(name)) for name in scenes},
        "pictures": {name: _picture_sha256(suite, name) for name in suite.images},
    }


def _picture_sha256(suite: Suite, name: str) -> str:
    kind, _, rest = name.rpartition(":")
    pixels = crop(suite, rest).tobytes() if kind else find_image(name).read_bytes()
    return hashlib.sha256(pixels).hexdigest()


def _code() -> dict[str, str]:
    here = Path(__file__).parent
    files = [here / name for name in _NUMBERS_COME_FROM]
    files.append(here.parent / "experiments" / "paper" / "moving_scene.py")
    return {file.name: hashlib.sha256(file.read_bytes()).hexdigest() for file in files}
