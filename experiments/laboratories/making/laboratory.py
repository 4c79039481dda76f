"""The stand-in laboratories: scene, surroundings, wall and camera of each."""

import re
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from experiments.laboratories.making import meshes
from experiments.laboratories.making.camera import Camera
from experiments.laboratories.making.paint import Paint, Poster

SCENES = Path(__file__).parents[1] / "scenes"


@dataclass(frozen=True)
class Laboratory:
    """A laboratory to be photographed.

    The scene file ``NAME.xml`` has the true places, the ruler's errors and the camera's film;
    ``NAME_room.xml`` what else there is.

    Attributes
    ----------
    name
        Of its files.
    hidden_image, hidden
        Name of the shipped picture on the monitor, and (rows, columns) of its patches.
    block
        Pixels of the photograph for each pixel of the scene's film, along each side.
    meshes
        Functions that make the occluders' meshes, by the files' names.
    paint, poster, camera
        The wall's and the camera's.
    sbr
        Mean of the monitor's light over that of all other.
    points
        Points of the wall that are measured: down and across.
    seed
        Of all draws.
    """

    name: str
    hidden_image: str
    hidden: tuple[int, int]
    block: int
    meshes: Mapping[str, Callable[[], Any]]
    paint: Paint
    camera: Camera
    seed: int
    poster: Poster | None = None
    sbr: float = 0.34
    points: tuple[int, int] = (3, 4)

    @property
    def scene(self) -> str:
        """Text of the scene file, with the true values."""
        return (SCENES / f"{self.name}.xml").read_text("utf-8")

    @property
    def room(self) -> str:
        """Text of the scene with all that stands around, as Mitsuba alone reads it."""
        around = (SCENES / f"{self.name}_room.xml").read_text("utf-8")
        shapes = around.partition('<scene version="3.0.0">')[2].rpartition("</scene>")[0]
        head, end, rest = self.scene.rpartition("</scene>")
        plain = _EXPONENT.sub("", head + shapes + end + rest)
        return plain.replace('<emitter type="lcd">', '<emitter type="area">')

    @property
    def exponents(self) -> tuple[float, float]:
        """The monitor's falloff with the vertical and the horizontal angle, which Mitsuba lacks."""
        declared = {axis: float(value) for axis, value in _EXPONENT.findall(self.scene)}
        return declared.get("vertical", 0.0), declared.get("horizontal", 0.0)


_EXPONENT = re.compile(r'\s*<float name="(vertical|horizontal)_exponent" value="([^"]*)"/>')

SHELF = Laboratory(
    name="shelf",
    hidden_image="digits",
    hidden=(21, 28),
    block=5,
    meshes={"shelf": meshes.shelf},
    paint=Paint(grain=(0.003, 0.02), passes=(0.1, 0.7), seam=(-0.07, 0.004, 0.4), seed=3),
    camera=Camera(vignetting=0.2, black=128, white=4095, read_noise=1.5),
    poster=Poster(0.02, 0.12, -0.20, -0.10, seed=5),
    sbr=0.5,
    seed=3,
)
"""A subject of `experiments.studies.wrong_scenes`."""

TUTORIAL = Laboratory(
    name="tutorial",
    hidden_image="mushroom",
    hidden=(15, 20),
    block=4,
    meshes={"lamp": meshes.lamp},
    paint=Paint(seed=5),
    camera=Camera(vignetting=0.15, sensitivity=(0.7, 1.0, 0.7)),
    poster=Poster(0.24, 0.40, 0.04, 0.22, seed=7),
    sbr=0.4,
    seed=5,
)
"""Small enough to be shipped, see `tutorial`."""
