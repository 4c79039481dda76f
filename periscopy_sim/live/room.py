"""The laboratory in 3-D: wall, monitor, occluders and the camera's view, as a scene says them."""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray

from periscopy_sim.live.level import LivePictures
from periscopy_sim.live.sheet import Pixels, monitor_pixels, photograph_pixels
from periscopy_sim.scenario import Array, Occluder, Scenario, WallFrame, wall_frame

AHEAD = 2e-3
"""Metres by which pictures stand before what they lie on."""

WALL, CASE, WOOD, RAYS = (236, 236, 232), (40, 42, 46), (150, 111, 78), (0, 114, 178)
FLOOR = (222, 222, 222)
CELLS = 10
"""Of the floor's grid in a metre."""

FRAME = 0.1
"""Width of the monitor's frame, both sides together, over the shorter side of its image."""

MARGIN = 0.12
"""Of wall and floor that are drawn, about what stands there."""

AROUND, ABOVE = 42.0, 20.0
"""Degrees of the first view, from looking at the wall, and downwards."""

FRAMED = 0.68
"""Distance of the first view over the laboratory's size."""


class Room:
    """What of a laboratory stands in a viser server's scene."""

    def __init__(self, server: Any, scenario: Scenario) -> None:
        self._scene = server.scene
        self._shapes: dict[str, Any] = {}
        self._images: dict[str, Any] = {}
        self._placed: dict[str, tuple[Any, ...]] = {}
        self._sources: tuple[Array, NDArray[np.intp], NDArray[np.bool_]] | None = None
        self._scene.set_up_direction("+z")
        frame = _frame_of(scenario)
        corners = _everything(scenario)
        self._place_wall(corners, frame)
        floor = _floor(corners, frame)
        self._show_lines("/floor", floor, FLOOR, thickness=1.0)
        framed = np.concatenate([corners, floor.reshape(-1, 3)])
        low, high = framed.min(axis=0), framed.max(axis=0)
        middle = (low + high) / 2
        size = float(np.linalg.norm(high - low))
        side, away = _level_axes(frame)
        a, h = np.radians([AROUND, ABOVE])
        back = np.cos(h) * (np.cos(a) * away + np.sin(a) * side) + np.sin(h) * np.eye(3)[2]
        server.initial_camera.look_at = tuple(middle)
        server.initial_camera.position = tuple(middle + FRAMED * size * back)

    def show(self, pictures: LivePictures) -> None:
        """Show a scene, the photograph on its wall and the image on its monitor."""
        scenario = pictures.scenario
        self._show_photograph(scenario, photograph_pixels(pictures))
        self._show_monitor(scenario, monitor_pixels(pictures))
        for occluder in scenario.occluders:
            self._show_occluder(occluder)
        self._show_view(pictures.rays)

    def _place_wall(self, corners: Array, frame: WallFrame) -> None:
        """Draw the wall behind all that stands before it, from the lowest of that upwards.

        As an image, which no lamp shades.
        """
        across, up = ((corners - frame.center) @ axis for axis in (frame.across, frame.up))
        wider = MARGIN * max(np.ptp(across), np.ptp(up))
        low = np.array([across.min() - wider, up.min()])
        high = np.array([across.max() + wider, up.max() + wider])
        middle = (low + high) / 2
        center = frame.center + middle[0] * frame.across + middle[1] * frame.up
        self._show_image(
            "/wall", np.full((8, 8, 3), WALL, np.uint8), high - low,
            center - AHEAD * frame.normal, frame.across, frame.up,
        )  # fmt: skip

    def _show_photograph(self, scenario: Scenario, pixels: Pixels) -> None:
        """Show the photograph where the camera sees it: each place as its nearest pixel."""
        frame = _frame_of(scenario)
        local = (scenario.wall_points - frame.center) @ np.stack([frame.across, frame.up]).T
        if self._sources is None or not (
            len(self._sources[0]) == len(local) and np.allclose(self._sources[0], local)
        ):
            self._sources = local, *_nearest_pixels(local, scenario.photograph_shape)
        _, sources, seen = self._sources
        shown = np.zeros((*seen.shape, 4), np.uint8)
        shown[..., :3] = pixels.reshape(-1, 3)[sources]
        shown[..., 3] = 255 * seen
        low, high = _extent(local, scenario.photograph_shape)
        middle = (low + high) / 2
        center = frame.center + middle[0] * frame.across + middle[1] * frame.up
        self._show_image(
            "/photograph", shown[..., :3] if seen.all() else shown, high - low,
            center + AHEAD * frame.normal, frame.across, frame.up,
        )  # fmt: skip

    def _show_monitor(self, scenario: Scenario, pixels: Pixels) -> None:
        rows, columns = scenario.hidden_shape
        across, up = (
            edges.mean(axis=0) * number
            for edges, number in (
                (scenario.patch_across, columns), (scenario.patch_up, rows)
            )
        )  # fmt: skip
        center = scenario.patch_centers.mean(axis=0)
        size = np.array([np.linalg.norm(across), np.linalg.norm(up)])
        self._show_image("/monitor", pixels, size, center, across, up)
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
            assert occluder.bounds is not None
            from trimesh.creation import box

            around = box(bounds=occluder.bounds)
            vertices, faces = np.asarray(around.vertices), np.asarray(around.faces)
        self._show_mesh(f"/occluders/{occluder.name}", vertices, faces, WOOD)

    def _show_view(self, rays: Array) -> None:
        """Show the rays through the picture's corners, and its border on the wall."""
        points = rays[:, 1]
        border = np.stack([points, np.roll(points, -1, axis=0)], axis=1)
        self._show_lines("/camera", np.concatenate([rays, border]), RAYS)

    # -- what is sent, only where it has changed ---------------------------------------------------

    def _show_image(
        self, name: str, pixels: Pixels, size: Array, center: Array, across: Array, up: Array
    ) -> None:
        width, height = (float(each) for each in size)
        wxyz, position = _pose(across, up), tuple(center)
        form = "png" if pixels.shape[2] == 4 else "jpeg"
        before = self._images.get(name)
        if before is None or self._placed[name][:3] != (width, height, form):
            self._images[name] = self._scene.add_image(
                name, pixels, width, height, format=form, jpeg_quality=92, wxyz=wxyz,
                position=position, cast_shadow=False, receive_shadow=False,
            )  # fmt: skip
            self._placed[name] = width, height, form
            return
        before.image, before.wxyz, before.position = pixels, wxyz, position

    def _show_mesh(self, name: str, vertices: Array, faces: Any, color: Any) -> None:
        before = self._shapes.get(name)
        points = np.asarray(vertices, np.float32)
        if before is not None and np.array_equal(before.vertices, points):
            return
        self._shapes[name] = self._scene.add_mesh_simple(
            name, points, np.asarray(faces), color=color, side="double", flat_shading=True,
            cast_shadow=False, receive_shadow=False,
        )  # fmt: skip

    def _show_lines(
        self, name: str, lines: Array, color: tuple[int, int, int], thickness: float = 2.0
    ) -> None:
        before = self._shapes.get(name)
        points = np.asarray(lines, np.float32)
        if before is not None and np.array_equal(before.points, points):
            return
        self._shapes[name] = self._scene.add_line_segments(
            name, points, np.broadcast_to(np.array(color, np.uint8), points.shape),
            thickness=thickness, thickness_units="screen",
        )  # fmt: skip


def _floor(corners: Array, frame: WallFrame) -> Array:
    """Return the lines, (n, 2, 3), of a level grid below all corners, up to the wall."""
    side, away = _level_axes(frame)
    s, t = ((corners - frame.center) @ axis for axis in (side, away))
    wider = MARGIN * np.ptp(s)
    ends = np.array([(s.min() - wider, min(t.min(), 0.0)), (s.max() + wider, t.max() + wider)])
    cells = np.ceil(CELLS * np.ptp(ends, axis=0)).astype(int)
    (s0, t0), (s1, t1) = ends[0], ends[0] + cells / CELLS
    at = np.arange(cells.max() + 1) / CELLS
    along = [[(s0, t0 + a), (s1, t0 + a)] for a in at[: cells[1] + 1]]
    across = [[(s0 + a, t0), (s0 + a, t1)] for a in at[: cells[0] + 1]]
    lines = frame.center + np.array([*along, *across]) @ np.stack([side, away])
    lines[..., 2] = corners[:, 2].min()
    return np.asarray(lines)


def _level_axes(frame: WallFrame) -> tuple[Array, Array]:
    """Return two level directions: to the right of who looks at the wall, and away from it."""
    flat = [axis * [1, 1, 0] for axis in (frame.normal, frame.up)]  # the latter for a ceiling
    away = next(axis for axis in flat if np.linalg.norm(axis) > 1 / 2)
    away = away / np.linalg.norm(away)
    return np.array([-away[1], away[0], 0.0]), away


def _frame_of(scenario: Scenario) -> WallFrame:
    return wall_frame(scenario.wall_points, scenario.wall_normals, scenario.photograph_shape)


def _everything(scenario: Scenario) -> Array:
    """Return points, (n, 3), about which the laboratory is framed: all but far surroundings."""
    monitor, wall = scenario.patch_centers, scenario.wall_points
    low, high = np.min([monitor.min(0), wall.min(0)], 0), np.max([monitor.max(0), wall.max(0)], 0)
    reach = float(np.linalg.norm(high - low))
    near = [
        each.vertices if each.vertices is not None else each.bounds for each in scenario.occluders
    ]
    inside = [p for p in near if p is not None and np.linalg.norm(np.ptp(p, axis=0)) < reach]
    return np.concatenate([monitor, wall, *inside])


def _extent(local: Array, shape: tuple[int, int]) -> tuple[Array, Array]:
    """Return the corners, (2,) each, of the rectangle about all pixels, whole ones."""
    low, high = local.min(axis=0), local.max(axis=0)
    rows, columns = shape
    half = (high - low) / np.maximum([columns - 1, rows - 1], 1) / 2
    return low - half, high + half


def _nearest_pixels(
    local: Array, shape: tuple[int, int]
) -> tuple[NDArray[np.intp], NDArray[np.bool_]]:
    """Return which pixel each place of the rectangle about all shows, and whether it shows any.

    `local` are the pixels' centres on the wall, (M, 2), across and up; the rectangle is cut as the
    photograph is, its first row at the top.
    """
    from scipy.spatial import KDTree

    rows, columns = shape
    low, high = _extent(local, shape)
    x = low[0] + (np.arange(columns) + 0.5) / columns * (high[0] - low[0])
    z = high[1] - (np.arange(rows) + 0.5) / rows * (high[1] - low[1])
    places = np.stack(np.meshgrid(x, z), axis=-1).reshape(-1, 2)
    apart, sources = KDTree(local).query(places)
    pixel = np.linalg.norm((high - low) / [columns, rows])
    return sources.reshape(shape), (apart < pixel).reshape(shape)


def _pose(across: Array, up: Array) -> tuple[float, float, float, float]:
    """Return the quaternion, w first, that turns an image's axes to a viewer's right and up."""
    from scipy.spatial.transform import Rotation

    x = across / np.linalg.norm(across)
    y = up - (up @ x) * x
    y = y / np.linalg.norm(y)
    # viser draws an image with its rows along y, downwards.
    turned = Rotation.from_matrix(np.stack([x, -y, np.cross(x, -y)], axis=1))
    qx, qy, qz, qw = turned.as_quat().tolist()
    return qw, qx, qy, qz
