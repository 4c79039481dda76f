"""The laboratory in 3-D: the scene's wall, monitor and occluders."""

from collections.abc import Callable
from functools import partial
from typing import Any

import numpy as np

from periscopy_sim.live.level import LivePictures
from periscopy_sim.live.sheet import Pixels, monitor_pixels, photograph_pixels
from periscopy_sim.numerics import Array
from periscopy_sim.scenario import Scenario
from periscopy_sim.view import WallFrame

COLOURS = {"wall": (236, 236, 232), "floor": (222, 222, 222), "occluder": (150, 111, 78)}

MARGIN = 0.12
"""Width of wall and floor beyond everything else, over its size."""


class Room:
    """The part of a laboratory that stands in a viser server's scene."""

    def __init__(self, server: Any, scenario: Scenario) -> None:
        self._scene = server.scene
        self._nodes: dict[str, Any] = {}
        self._scene.set_up_direction("+z")
        points, frame = _everything(scenario), _frame_of(scenario)
        low, high = points.min(axis=0), points.max(axis=0)
        middle, size = (low + high) / 2, float(np.linalg.norm(high - low))
        width, depth, _ = high - low + MARGIN * size
        self._scene.add_grid(
            "/floor", width, depth, cell_size=0.1, section_size=0.1,
            section_color=COLOURS["floor"], position=(middle[0], middle[1], low[2]),
        )  # fmt: skip
        # The wall is an image, which no lamp shades, just behind everything.
        local = _on_wall(points, frame)
        margin = MARGIN * size * np.array([1.0, 0.0])
        low, high = local.min(axis=0) - margin, local.max(axis=0) + MARGIN * size
        blank = np.full((8, 8, 3), COLOURS["wall"], np.uint8)
        self._show_on_wall("/wall", blank, low, high, frame, -0.002)
        # The first view: from beside the viewer of the wall, and from above.
        back = 0.7 * frame.normal + 0.6 * frame.across + np.array([0, 0, 0.35])
        server.initial_camera.look_at = tuple(middle)
        server.initial_camera.position = tuple(middle + 0.8 * size * back)

    def show(self, pictures: LivePictures) -> None:
        """Show a scene, the photograph on its wall and the image on its monitor."""
        scenario = pictures.scenario
        frame = _frame_of(scenario)
        local = _on_wall(scenario.view.centers, frame)
        shown, low, high = on_rectangle(local, photograph_pixels(pictures))
        self._show_on_wall("/photograph", shown, low, high, frame, 0.002)
        rows, columns = scenario.hidden_shape
        self._show_image(
            "/monitor", monitor_pixels(pictures), scenario.hidden.centers.mean(axis=0),
            columns * scenario.hidden.across.mean(axis=0), rows * scenario.hidden.up.mean(axis=0),
        )  # fmt: skip
        for each in scenario.scene.occluders:
            vertices, faces = each.vertices, each.faces
            if vertices is None or faces is None:  # no mesh: the box about it
                from trimesh.creation import box

                around = box(bounds=each.bounds)
                vertices, faces = np.asarray(around.vertices), np.asarray(around.faces)
            add = partial(
                self._scene.add_mesh_simple, faces=faces, color=COLOURS["occluder"], side="double",
                flat_shading=True,
            )  # fmt: skip
            self._show(f"/occluders/{each.name}", add, vertices=vertices.astype(np.float32))

    def _show_on_wall(
        self, name: str, pixels: Pixels, low: Array, high: Array, frame: WallFrame, ahead: float
    ) -> None:
        """Show an image on the wall's rectangle from `low` to `high`, (2,) across and up."""
        (x, z), (width, height) = (low + high) / 2, high - low
        center = frame.center + x * frame.across + z * frame.up + ahead * frame.normal
        self._show_image(name, pixels, center, width * frame.across, height * frame.up)

    def _show_image(
        self, name: str, pixels: Pixels, center: Array, across: Array, up: Array
    ) -> None:
        width, height = (float(np.linalg.norm(axis)) for axis in (across, up))
        self._show(
            name, self._scene.add_image, image=pixels, render_width=width, render_height=height,
            wxyz=pose_of(across, up), position=tuple(center),
        )  # fmt: skip

    def _show(self, name: str, add: Callable[..., Any], **properties: Any) -> None:
        """Add a node, or change the one of this name: viser sends what differs."""
        if name in self._nodes:
            for key, value in properties.items():
                setattr(self._nodes[name], key, value)
        else:
            self._nodes[name] = add(name, **properties, cast_shadow=False, receive_shadow=False)


def on_rectangle(local: Array, pixels: Pixels) -> tuple[Pixels, Array, Array]:
    """Resample a photograph on the rectangle about all its pixels, each place by the nearest.

    `local`, (M, 2), are the pixels' centres on the wall, across and up, in metres. Return an image,
    (rows, columns, 4), with opacity 0 where the camera sees nothing, and the rectangle's lower and
    upper corner, (2,) each.
    """
    from scipy.interpolate import NearestNDInterpolator

    rows, columns, _ = pixels.shape
    low, high = local.min(axis=0), local.max(axis=0)
    half = (high - low) / np.maximum([columns - 1, rows - 1], 1) / 2
    low, high = low - half, high + half
    x = low[0] + (np.arange(columns) + 0.5) / columns * (high[0] - low[0])
    z = high[1] - (np.arange(rows) + 0.5) / rows * (high[1] - low[1])
    nearest = NearestNDInterpolator(local, pixels.reshape(-1, 3).astype(float))
    reach = float(2 * np.linalg.norm(half))
    values = nearest(np.stack(np.meshgrid(x, z), axis=-1), distance_upper_bound=reach)
    seen = np.isfinite(values[..., :1])
    return np.concatenate([np.where(seen, values, 0), 255 * seen], -1).astype(np.uint8), low, high


def pose_of(across: Array, up: Array) -> tuple[float, ...]:
    """Return the quaternion, w first, that turns an image's axes to a viewer's right and up."""
    from scipy.spatial.transform import Rotation

    x = across / np.linalg.norm(across)
    y = up - (up @ x) * x
    y = y / np.linalg.norm(y)
    # viser draws an image with its rows along y, downwards.
    turned = Rotation.from_matrix(np.stack([x, -y, np.cross(x, -y)], axis=1))
    return tuple(turned.as_quat(scalar_first=True).tolist())


def _frame_of(scenario: Scenario) -> WallFrame:
    return scenario.view.frame


def _on_wall(points: Array, frame: WallFrame) -> Array:
    """Return points on the wall, (n, 2), across and up, in metres."""
    return np.asarray((points - frame.center) @ np.stack([frame.across, frame.up]).T)


def _everything(scenario: Scenario) -> Array:
    """Return the points, (n, 3), of all but far surroundings."""
    both = np.concatenate([scenario.hidden.centers, scenario.view.centers])
    reach = float(np.linalg.norm(np.ptp(both, axis=0)))
    shapes = [o.bounds if o.vertices is None else o.vertices for o in scenario.scene.occluders]
    near = [p for p in shapes if p is not None and np.linalg.norm(np.ptp(p, axis=0)) < reach]
    return np.concatenate([both, *near])
