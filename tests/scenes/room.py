"""A room in Mitsuba's own words."""

from itertools import count
from pathlib import Path

import numpy as np
import pytest

from periscopy_sim.scenario import Scenario, load_scenario


class Room:
    """Scene files of a wall at y = 1, seen squarely, and a monitor at y = 0 that faces it.

    The camera's square pixels cover 0.4 m in x about (0.7, 1, 0.3); the monitor is 0.4 m x 0.3 m
    about (0.2, 0, 0.3). The wall's albedo is 0.5.
    """

    diffuse = '<bsdf type="diffuse"><rgb name="reflectance" value="0.5"/></bsdf>'
    black = '<bsdf type="diffuse"><rgb name="reflectance" value="0"/></bsdf>'
    area = '<emitter type="area"><rgb name="radiance" value="1"/></emitter>'

    def __init__(self, folder: Path) -> None:
        self.folder = folder
        self.number = count(1)

    @staticmethod
    def lcd(vertical: float = 18, horizontal: float = 1) -> str:
        return (
            '<emitter type="lcd"><rgb name="radiance" value="1"/>'
            f'<float name="vertical_exponent" value="{vertical}"/>'
            f'<float name="horizontal_exponent" value="{horizontal}"/></emitter>'
        )

    @staticmethod
    def wall(bsdf: str = diffuse, *, angle: float = 90, x: float = 0.7) -> str:
        return (
            f'<shape type="rectangle" id="wall">{bsdf}<transform name="to_world">'
            f'<rotate x="1" angle="{angle}"/><translate x="{x}" y="1" z="0.3"/>'
            "</transform></shape>"
        )

    @staticmethod
    def monitor(
        emitter: str | None = None,
        *,
        scale: tuple[float, float] = (0.2, 0.15),
        turn: float = 180,
        tilt: float = 0,
        y: float = 0,
        flip: bool = False,
        inside: str = black,
    ) -> str:
        """Turned about z and tilted about x, in degrees; a turn of 180 faces the wall."""
        return (
            '<shape type="rectangle" id="monitor">'
            f'<boolean name="flip_normals" value="{str(flip).lower()}"/>'
            f'<transform name="to_world"><scale x="{scale[0]}" y="{scale[1]}"/>'
            f'<rotate x="1" angle="90"/><rotate z="1" angle="{turn}"/>'
            f'<rotate x="1" angle="{tilt}"/><translate x="0.2" y="{y}" z="0.3"/></transform>'
            f"{Room.lcd() if emitter is None else emitter}{inside}</shape>"
        )

    def curved_monitor(self, emitter: str, *, mirrored: bool = False, flip: bool = False) -> str:
        """A screen bent about a vertical axis towards the wall, 0.3 m high, as a PLY mesh.

        It spans 0.8 rad of a circle of radius 0.5 m about (0.2, 0.5), in 16 facets.
        """
        angle = 0.8 * (np.linspace(0, 1, 17) - 0.5)
        x, y = 0.2 - 0.5 * np.sin(angle), 0.5 - 0.5 * np.cos(angle)
        return self._strip(x, y, emitter, mirrored=mirrored, flip=flip)

    def folded_monitor(self) -> str:
        """A screen of eight folds 0.2 m deep, whose ridges hide its valleys from the side."""
        x = np.linspace(0.4, 0.0, 17)
        return self._strip(x, 0.2 * (np.arange(17) % 2), self.area)

    def _strip(
        self, x: np.ndarray, y: np.ndarray, emitter: str, *, mirrored=False, flip=False
    ) -> str:
        """A vertical band through points in x and y, as a PLY mesh of equal parts in u."""
        trimesh = pytest.importorskip("trimesh")
        n = len(x)
        u, v = (grid.ravel() for grid in np.meshgrid(np.linspace(0, 1, n), [0.0, 1.0]))
        left = np.arange(n - 1)
        faces = np.concatenate(
            [
                np.stack([left, left + 1, left + n + 1], 1),
                np.stack([left, left + n + 1, left + n], 1),
            ]
        )
        uv = np.stack([1 - u if mirrored else u, v], axis=1)
        mesh = trimesh.Trimesh(
            np.stack([np.tile(x, 2), np.tile(y, 2), 0.15 + 0.3 * v], axis=1),
            faces[:, ::-1] if flip else faces,
            visual=trimesh.visual.TextureVisuals(uv=uv),
            process=False,
        )
        mesh.export(self.folder / "screen.ply")
        return (
            '<shape type="ply" id="monitor"><string name="filename" value="screen.ply"/>'
            '<boolean name="face_normals" value="true"/>'
            f'<boolean name="flip_normals" value="{str(flip).lower()}"/>{emitter}{self.black}'
            "</shape>"
        )

    @staticmethod
    def camera(
        size: tuple[int | str, int | str] = (5, 6),
        *,
        film: str = "hdrfilm",
        inside_film: str = '<rfilter type="box"/>',
    ) -> str:
        return (
            '<sensor type="orthographic" id="camera"><transform name="to_world">'
            '<scale x="0.2" y="0.2"/><lookat origin="0.7, 0.9, 0.3" target="0.7, 1, 0.3" '
            f'up="0, 0, 1"/></transform><film type="{film}">'
            f'<integer name="height" value="{size[0]}"/><integer name="width" value="{size[1]}"/>'
            f"{inside_film}</film></sensor>"
        )

    @staticmethod
    def blocker(center: str = "0.45, 0.5, 0.3", radius: float = 0.06, bsdf: str = black) -> str:
        return (
            f'<shape type="sphere" id="ball"><point name="center" value="{center}"/>'
            f'<float name="radius" value="{radius}"/>{bsdf}</shape>'
        )

    @staticmethod
    def cube(
        center: tuple[float, ...], half: tuple[float, ...], name: str = "box", inside: str = ""
    ) -> str:
        """A box of half extents about a centre."""
        scale, place = (", ".join(map(str, each)) for each in (half, center))
        return (
            f'<shape type="cube" id="{name}"><transform name="to_world"><scale value="{scale}"/>'
            f'<translate value="{place}"/></transform>{inside}</shape>'
        )

    def write(
        self,
        *extra: str,
        wall: str | None = None,
        monitor: str | None = None,
        camera: str | None = None,
    ) -> Path:
        """Write a scene to a file of its own; an empty part is left out."""
        parts = [
            self.wall() if wall is None else wall,
            self.monitor() if monitor is None else monitor,
            self.camera() if camera is None else camera,
            *extra,
        ]
        path = self.folder / f"room{next(self.number)}.xml"
        path.write_text('<scene version="3.0.0">\n' + "\n".join(parts) + "\n</scene>\n")
        return path

    def load(self, *extra: str, hidden: tuple[int, int] = (2, 3), **parts: str) -> Scenario:
        return load_scenario(self.write(*extra, **parts), hidden)
