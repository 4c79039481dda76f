"""A stand-in laboratory: its scene, what stands around it, its wall, camera and ruler."""

from __future__ import annotations

import re
from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

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
    hidden_image
        Name of the shipped picture on the monitor.
    hidden
        (rows, columns) of the picture's patches.
    block
        Pixels of the photograph for each pixel of the scene's film, along each side.
    meshes
        What makes the occluders' files, by name.
    paint, poster, camera
        The wall's and the camera's.
    sbr
        Mean of the monitor's light over that of all other.
    snr
        dB after averaging to the scene's film.
    unevenness
        Root mean square of the paint, seen at the film's resolution, by the photograph's name.
    points
        Points of the wall that are measured: down and across.
    rulers
        How many persons measure.
    measured_camera
        How the names of the camera's numbers begin.
    """

    name: str
    hidden_image: str
    hidden: tuple[int, int]
    block: int
    meshes: Mapping[str, Callable[[], Any]]
    paint: Paint
    camera: Camera
    poster: Poster | None = None
    sbr: float = 0.34
    snr: float = 60.0
    unevenness: Mapping[str, float] = field(
        default_factory=lambda: {"even": 0.0, "": 0.004, "rough": 0.008}
    )
    points: tuple[int, int] = (3, 4)
    rulers: int = 4
    measured_camera: tuple[str, ...] = ("camera", "aim")
    seed: int = 0

    @property
    def scene(self) -> str:
        """Text of the scene file, with the true values."""
        return (SCENES / f"{self.name}.xml").read_text("utf-8")

    @property
    def room(self) -> str:
        """Text of the scene with all that stands around, in one file."""
        around = (SCENES / f"{self.name}_room.xml").read_text("utf-8")
        shapes = around.partition('<scene version="3.0.0">')[2].rpartition("</scene>")[0]
        head, end, rest = self.scene.rpartition("</scene>")
        return plain(head + shapes + end + rest)

    @property
    def exponents(self) -> tuple[float, float]:
        """The monitor's falloff with the vertical and the horizontal angle."""
        vertical, horizontal = (
            _EXPONENT[name].search(self.scene) for name in ("vertical", "horizontal")
        )
        return (
            float(vertical["value"]) if vertical else 0.0,
            float(horizontal["value"]) if horizontal else 0.0,
        )


_EXPONENT = {
    name: re.compile(rf'\s*<float name="{name}_exponent" value="(?P<value>[^"]*)"/>')
    for name in ("vertical", "horizontal")
}


def plain(text: str) -> str:
    """Return a scene file as Mitsuba alone reads it: an LCD's falloff, which it lacks, left out."""
    for pattern in _EXPONENT.values():
        text = pattern.sub("", text)
    return text.replace('<emitter type="lcd">', '<emitter type="area">')
