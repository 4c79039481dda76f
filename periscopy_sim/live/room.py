"""The laboratory in 3-D: the scene's wall, monitor and occluders."""

from __future__ import annotations

from typing import Any

import numpy as np

from periscopy_sim.live.level import LivePictures
from periscopy_sim.live.sheet import Pixels, monitor_pixels, photograph_pixels
from periscopy_sim.scenario import Array, Occluder, Scenario, WallFrame, wall_frame

AHEAD = 2e-3
"""Metres by which pictures stand before their surface."""

WALL, CASE, WOOD = (236, 236, 232), (40, 42, 46), (150, 111, 78)

FRAME = 0.1
"""Width of the monitor's frame, both sides together, over the shorter side of its image."""

MARGIN = 0.12
"""Width of wall and floor beyond everything else, over its size."""


class Room:
    """The part of a laboratory that stands in a viser server's scene."""

    def __init__(self, server: Any, scenario: Scenario) -> None:
        self._scene = server.scene
        self._nodes: dict[str, tuple[Any, Any, dict[str, Any]]] = {}
        self._scene.set_up_direction("+z")
        frame, points = _frame_of(scenario), _everything(scenario)
        self._place_wall(points, frame)
        low, high = points.min(axis=0), points.max(axis=0)
        middle, size = (low + high) / 2, float(np.linalg.norm(high - low))
        width, depth, _ = high - low + MARGIN * size
        self._scene.add_grid(
            "/floor", width, depth, cell_size=0.1, section_size=0.1,
            section_color=(222, 222, 222), position=(middle[0], middle[1], low[2]),
        )  # fmt: skip
        # From beside the viewer of the wall, and from above.
        back = 0.7 * frame.normal + 0.6 * frame.across + np.array([0, 0, 0.35])
        server.initial_camera.look_at = tuple(middle)
        server.initial_camera.position = tuple(middle + 0.8 * size * back)

    def show(self, pictures: LivePictures) -> None:
        """Show a scene, the photograph on its wall and the image on its monitor."""
        self._show_photograph(pictures.scenario, photograph_pixels(pictures))
        self._show_monitor(pictures.scenario, monitor_pixels(pictures))
        for occluder in pictures.scenario.occluders:
            self._show_occluder(occluder)

    def _place_wall(self, points: Array, frame: WallFrame) -> None:
        """Draw the wall behind all that stands before it; as an image, which no lamp shades."""
        across, up = ((points - frame.center) @ axis for axis in (frame.across, frame.up))
        wider = MARGIN * max(np.ptp(across), np.ptp(up))
        low = np.array([across.min() - wider, up.min()])
        high = np.array([across.max() + wider, up.max() + wider])
        self._show_image("/wall", np.full((8, 8, 3), WALL, np.uint8), low, high, frame, -AHEAD)

    def _show_photograph(self, scenario: Scenario, pixels: Pixels) -> None:
        """Show the photograph where the camera sees it."""
        frame = _frame_of(scenario)
        local = (scenario.wall_points - frame.center) @ np.stack([frame.across, frame.up]).T
        shown, low, high = on_rectangle(local, pixels)
        self._show_image("/photograph", shown, low, high, frame, AHEAD)

    def _show_monitor(self, scenario: Scenario, pixels: Pixels) -> None:
        rows, columns = scenario.hidden_shape
        across = columns * scenario.patch_across.mean(axis=0)
        up = rows * scenario.patch_up.mean(axis=0)
        center = scenario.patch_centers.mean(axis=0)
        size = np.array([np.linalg.norm(across), np.linalg.norm(up)])
        pose = {"wxyz": pose_of(across, up), "position": tuple(center)}
        self._show("/monitor", self._scene.add_image, {"image": pixels, **pose}, *size.tolist())
        # Only a frame: from behind, where most of the laboratory is seen, the image shines through.
        outer = 1 + FRAME * size.min() / size
        ring = np.array([(-1, -1), (1, -1), (1, 1), (-1, 1)]) / 2
        corners = [center + s * across + t * up for s, t in np.concatenate([ring, ring * outer])]
        around = [(k, (k + 1) % 4) for k in range(4)]
        faces = [f for a, b in around for f in ((a, b, a + 4), (b, b + 4, a + 4))]
        self._show_mesh("/frame", np.array(corners), np.array(faces), CASE)

    def _show_occluder(self, occluder: Occluder) -> None:
        """Show a mesh; of another shape the box about it."""
        vertices, faces = occluder.vertices, occluder.faces
        if vertices is None or faces is None:
            from trimesh.creation import box

            around = box(bounds=occluder.bounds)
            vertices, faces = np.asarray(around.vertices), np.asarray(around.faces)
        self._show_mesh(f"/occluders/{occluder.name}", vertices, faces, WOOD)

    # -- only changes are sent ---------------------------------------------------------------------

    def _show_image(
        self, name: str, pixels: Pixels, low: Array, high: Array, frame: WallFrame, ahead: float
    ) -> None:
        """Show an image on the wall's rectangle from `low` to `high`, (2,) across and up."""
        x, z = (low + high) / 2
        center = frame.center + x * frame.across + z * frame.up + ahead * frame.normal
        pose = {"wxyz": pose_of(frame.across, frame.up), "position": tuple(center)}
        self._show(name, self._scene.add_image, {"image": pixels, **pose}, *(high - low).tolist())

    def _show_mesh(self, name: str, vertices: Array, faces: Any, color: Any) -> None:
        self._show(
            name, self._scene.add_mesh_simple, {"vertices": vertices.astype(np.float32)},
            faces=faces, color=color, side="double", flat_shading=True,
        )  # fmt: skip

    def _show(
        self, name: str, add: Any, changing: dict[str, Any], *size: float, **options: Any
    ) -> None:
        """Add a node, or set those of its changing properties that differ from before."""
        size = tuple(round(each, 6) for each in size)
        node, size_before, before = self._nodes.get(name, (None, None, {}))
        if node is None or size != size_before:
            node = add(
                name, **changing, **options, cast_shadow=False, receive_shadow=False,
                **dict(zip(("render_width", "render_height"), size, strict=False)),
            )  # fmt: skip
        else:
            for key, value in changing.items():
                if not np.array_equal(before[key], value):
                    setattr(node, key, value)
        self._nodes[name] = node, size, changing


def on_rectangle(local: Array, pixels: Pixels) -> tuple[Pixels, Array, Array]:
    """Resample a photograph on the rectangle about all its pixels, each place by the nearest.

    Parameters
    ----------
    local
        (M, 2) the pixels' centres on the wall, across and up, in metres.
    pixels
        (rows, columns, 3) the photograph.

    Returns
    -------
    image, low, high
        (rows, columns, 4) with opacity 0 where the camera sees nothing; the rectangle's corners,
        (2,) each.
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
    return wall_frame(scenario.wall_points, scenario.wall_normals, scenario.photograph_shape)


def _everything(scenario: Scenario) -> Array:
    """Return the points, (n, 3), of all but far surroundings."""
    both = np.concatenate([scenario.patch_centers, scenario.wall_points])
    reach = float(np.linalg.norm(np.ptp(both, axis=0)))
    shapes = [o.bounds if o.vertices is None else o.vertices for o in scenario.occluders]
    near = [p for p in shapes if p is not None and np.linalg.norm(np.ptp(p, axis=0)) < reach]
    return np.concatenate([both, *near])
