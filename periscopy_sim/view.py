"""What a camera sees of the relay wall: with the hidden patches, the rows and the columns of A."""

from collections.abc import Mapping
from dataclasses import dataclass, replace
from functools import cached_property
from pathlib import Path
from typing import Self

import numpy as np
from numpy.typing import NDArray

from periscopy_sim.errors import SceneError
from periscopy_sim.hidden import Hidden, Size, Surface
from periscopy_sim.numerics import Array, Image, Mask, validation
from periscopy_sim.scene import CAMERA, WALL, Occluder, Scene, SceneDocument

POINT_SIDE = 1e-6
"""Side of a pixel that counts as a point, in metres."""

LIFT = 1e-4
"""Height of points just off the wall, over the diagonal of what the camera sees of it."""


@dataclass(frozen=True, eq=False)
class View:
    """One camera's pixels on the relay wall; M pixels, each averaged over K points.

    Attributes
    ----------
    scene
        The scene that the camera is in.
    shape
        (rows, columns) of the photograph.
    points
        (M, K, 3) wall points that the pixels see, in metres; row-major, as the pixels are.
    normals
        (M, K, 3) unit normals there, towards the camera.
    rays
        (2, M K, 3) origins and directions of the camera's rays to these points.
    corners
        (2, 4, 3) where the rays through the photograph's corner pixels, in turn, start and end.
    reflectance
        (3,) albedo of a diffuse wall, or (M, 3) of each pixel's area where the wall has a texture;
        None for another material.
    channel_gain
        (3,) the wall's colour, mean 1, or (M, 3) of a texture in each pixel, beside the albedo in
        A's row: a photograph's channel c is channel_gain[..., c] * A @ f[:, c].
    texture
        (M, K, 3) albedo about each point over its pixel's; None of a wall without a texture.
    relief
        How far the wall's shape, seen or not, reaches into the room out of the plane that is seen,
        in metres: there it might cast shadows.
    pixels
        (rows, columns) which pixels the view has; None for all.
    is_cut
        Whether the field of view was cut into a shape of its own, not into the film's pixels.
    camera, wall
        Ids of the sensor, and of the relay wall that it sees.
    """

    scene: Scene
    shape: tuple[int, int]
    points: Array
    normals: Array
    rays: Array
    corners: Array
    reflectance: Array | None
    channel_gain: Array
    texture: Array | None = None
    relief: float = 0.0
    pixels: Mask | None = None
    is_cut: bool = False
    camera: str = CAMERA
    wall: str = WALL

    @classmethod
    def of(
        cls,
        scene: Scene,
        shape: tuple[int, int] | str | None = None,
        *,
        across: int = 1,
        camera: str = CAMERA,
    ) -> "View":
        """Return what a scene's camera sees of the wall that the middle of its picture shows.

        Parameters
        ----------
        scene
            The scene.
        shape
            (rows, columns), or ROWSxCOLUMNS, into which the field of view is cut; None for the
            film's own pixels.
        across
            Points along each side of a pixel, over which the pixel is averaged; 1 is its centre.
        camera
            Id of the sensor.

        Raises
        ------
        SceneError
            If there is no such sensor, a pixel misses the wall, or the wall is none that A can
            treat; see `load_scenario`.
        """
        size = None if shape is None else validation.size_of(shape)
        view: View = scene.source.view(scene, size, across, camera)
        return view

    @property
    def occluders(self) -> tuple[Occluder, ...]:
        """The shapes that may hide hidden surfaces: occluders and walls that it does not see."""
        others = (each for each in self.scene.walls if each.name != self.wall)
        return *self.scene.occluders, *others

    def before(self, name: str) -> tuple[Occluder, ...]:
        """Return all that may hide a hidden surface: occluders, and the other opaque surfaces."""
        clear = (name, *self.scene.transparent)
        return *self.occluders, *(each for each in self.scene.surfaces if each.name not in clear)

    @cached_property
    def albedo(self) -> Array:
        """Albedo in A's rows, () or of a texture (M,); of a diffuse wall.

        One albedo serves all channels, whose `channel_gain` is the rest. Noise of a photograph over
        that gain is as strong in each pixel, in the mean over the channels: so of a texture that is
        dark in one channel, the albedo is little, and the gain is not.
        """
        assert self.reflectance is not None
        return np.asarray(self.reflectance.sum(axis=-1) / self.channel_gain.sum(axis=-1))

    @property
    def paint(self) -> Array:
        """(M, 1) albedo in A's rows over their mean; (1, 1), one, without a texture."""
        if self.texture is None:
            return np.ones((1, 1))
        return np.asarray(self.albedo / self.albedo.mean())[:, np.newaxis]

    @cached_property
    def point_paint(self) -> Array:
        """(M, K) the same about each point: A averages over the points by these weights."""
        return np.ones((1, 1)) if self.texture is None else self.paint * self.texture.mean(axis=2)

    @property
    def painted_normals(self) -> Array:
        """(M, K, 3) normals, as long as `point_paint`: all diffuse light is linear in them."""
        return self.normals * self.point_paint[..., np.newaxis]

    @property
    def even(self) -> "View":
        """The view of the same wall without its texture, in the texture's mean colour.

        Smooth light on this wall, such as ambient light, becomes that on the textured one by its
        `paint`, which A's rows have.
        """
        if self.texture is None:
            return self
        colour = (self.channel_gain * self.paint).mean(axis=0)
        gain = colour / colour.mean()
        reflectance = self.albedo.mean() * gain
        return replace(self, reflectance=reflectance, channel_gain=gain, texture=None)

    def of_channel(self, channel: int) -> "View":
        """Return the view of a grey wall that reflects as one channel of this wall does.

        By its A a texture's colours are exact within a pixel, too.
        """
        assert self.reflectance is not None
        one = [channel] * 3
        return replace(
            self,
            reflectance=self.reflectance[..., one],
            channel_gain=np.ones_like(self.channel_gain),
            texture=None if self.texture is None else self.texture[..., one],
        )

    @property
    def numbers(self) -> NDArray[np.intp]:
        """(M,) row-major numbers of the pixels in the photograph."""
        if self.pixels is None:
            return np.arange(len(self.points))
        return np.flatnonzero(self.pixels)

    @property
    def across(self) -> int:
        """Points along each side of a pixel: the root of K."""
        return round(float(np.sqrt(self.points.shape[1])))

    @cached_property
    def centers(self) -> Array:
        """(M, 3) mean points of the pixels."""
        return np.asarray(self.points.mean(axis=1))

    @cached_property
    def center_normals(self) -> Array:
        """(M, 3) unit normals in the pixels, towards the camera."""
        normals = self.normals.mean(axis=1)
        return np.asarray(normals / np.linalg.norm(normals, axis=1, keepdims=True))

    @cached_property
    def frame(self) -> "WallFrame":
        """Axes of the field of view, by the photograph's own rows and columns."""
        corners = None if self.pixels is None else self.corners[1]
        return wall_frame(self.centers, self.center_normals, self.shape, corners)

    @cached_property
    def edges(self) -> Array:
        """(M, 2, 3) edges of the pixels, down and across; of a view with all pixels."""
        return pixel_edges(self.centers, self.center_normals, self.shape)

    @cached_property
    def surface(self) -> Surface:
        """The part of the wall that the camera sees, its pixels as patches."""
        down, across = np.moveaxis(self.edges, 1, 0)
        return Surface(self.shape, self.centers, self.center_normals, across, -down)

    def of_pixels(self, pixels: Mask) -> "View":
        """Return the view of some of this view's pixels: True of (rows, columns)."""
        used, K = pixels.ravel()[self.numbers], self.points.shape[1]
        by_pixel = ["points", "normals"]
        if self.texture is not None:
            by_pixel += ["reflectance", "channel_gain", "texture"]
        chosen = {name: getattr(self, name)[used] for name in by_pixel}
        return replace(self, **chosen, rays=self.rays[:, np.repeat(used, K)], pixels=pixels)

    def moved(self, scene: Scene, motions: Mapping[str, Array]) -> "View | None":
        """Return the view in a scene whose things moved; None where only rays can show it.

        The motions, (4, 4), are by id. The camera's rays meet the wall's plane elsewhere: exact
        while the wall is a plain rectangle and no shape comes near the camera's view of it. The
        colours of a texture stay those of this view.
        """
        view = replace(self, scene=scene)
        if motions.keys() & {self.camera, self.wall}:
            if scene.plugins[self.wall] != "rectangle":
                return None
            walls = self.scene.places[self.wall], scene.places[self.wall]
            camera = motions.get(self.camera, np.eye(4))
            (eyes, seen), (origins, directions) = self.corners, self.rays
            ends = _met_again(eyes, seen - eyes, camera, walls)
            met = _met_again(origins, directions, camera, walls)
            if ends is None or met is None:
                return None
            points, normals = (each.reshape(self.points.shape) for each in met[2:])
            corners = np.stack([ends[0], ends[2]])
            view = replace(
                view, rays=np.stack(met[:2]), corners=corners, points=points, normals=normals
            )
        return view if view.is_free() else None

    def is_free(self) -> bool:
        """Return whether planes separate the boxes of other shapes from the view of the wall."""
        eyes, seen = self.corners
        sides = np.cross(np.roll(seen, -1, axis=0) - seen, eyes - seen)
        planes = np.concatenate([np.eye(3), sides, [(seen - eyes).sum(axis=0)]]).T
        view = np.concatenate([seen, eyes]) @ planes
        boxes = [box for name, box in self.scene.boxes.items() if name != self.wall] @ planes
        beside = (boxes.min(axis=1) > view.max(axis=0)) | (boxes.max(axis=1) < view.min(axis=0))
        return bool(beside.any(axis=1).all())


def moved_points(points: Image, motion: Array) -> Array:
    """Return points, (n, 3), moved by a matrix, (4, 4)."""
    return np.asarray(points @ motion[:3, :3].T + motion[:3, 3])


def _met_again(
    origins: Array, directions: Array, camera: Array, walls: tuple[Array, Array]
) -> tuple[Array, Array, Array, Array] | None:
    """Return moved rays, (n, 3) each, where they meet a moved rectangle, and its normals there.

    `walls` are its places before and now. None if a ray misses it or meets its other side.
    """
    before, normal = map(_front, walls)
    side = directions @ before
    origins, directions = moved_points(origins, camera), directions @ camera[:3, :3].T
    ahead, place = directions @ normal, walls[1]
    with np.errstate(divide="ignore", invalid="ignore"):
        distance = (place[:3, 3] - origins) @ normal / ahead
        points = origins + distance[:, None] * directions
        to_square = np.asarray(np.linalg.inv(place), np.float64)
        inside = np.abs(moved_points(points, to_square)[:, :2]) <= 1
    if not (inside.all() and (distance > 0).all() and (ahead * side > 0).all()):
        return None
    return origins, directions, points, -np.sign(ahead)[:, None] * normal


def _front(place: Array) -> Array:
    """Return the unit normal of a rectangle."""
    normal = np.cross(place[:3, 0], place[:3, 1])
    return np.asarray(normal / np.linalg.norm(normal))


def pixel_edges(points: Array, normals: Array, shape: tuple[int, int]) -> Array:
    """Return the edges, (M, 2, 3) down and across, of pixels whose centres are the (M, 3) points.

    Pixels of a lone row or column count as square, a lone pixel as a point.
    """
    rows, columns = shape
    grid, normal = points.reshape(*shape, 3), normals.reshape(*shape, 3)
    if rows > 1:
        down = np.asarray(np.gradient(grid, axis=0))
    if columns > 1:
        across = np.asarray(np.gradient(grid, axis=1))
    elif rows > 1:
        across = np.cross(normal, down)
    else:
        across = POINT_SIDE * np.cross(normal, np.eye(3)[np.abs(normals[0]).argmin()])
    if rows == 1:
        down = np.cross(normal, across)
    return np.stack([down, across], axis=2).reshape(-1, 2, 3)


def rises(points: Array, normals: Array, shape: tuple[int, int]) -> Array:
    """Return how far the pixels next to each rise above its tangent plane, (M,), at least 0.

    Rays that start lower may start behind a wall that bends towards the room.
    """
    grid, normal = points.reshape(*shape, 3), normals.reshape(*shape, 3)
    height = np.zeros(shape)
    for axis in (0, 1):
        p, n, h = (np.swapaxes(each, 0, axis) for each in (grid, normal, height))
        step = np.diff(p, axis=0)
        np.maximum(h[:-1], np.sum(step * n[:-1], axis=-1), out=h[:-1])
        np.maximum(h[1:], -np.sum(step * n[1:], axis=-1), out=h[1:])
    return height.ravel()


@dataclass(frozen=True, eq=False)
class WallFrame:
    """Axes of the camera's field of view on the wall, about the wall points' centroid (metres).

    They are orthonormal: the photograph's columns run along across, as far as the wall's plane
    allows; the normal points into the room; up completes them.
    """

    center: Array
    across: Array
    normal: Array
    up: Array


def wall_frame(
    points: Array, normals: Array, shape: tuple[int, int], corners: Array | None = None
) -> WallFrame:
    """Orient the field of view by the photograph's own rows and columns.

    Points (M, 3) are in metres, normals (M, 3) of unit length, `shape` is the photograph's (rows,
    columns). Where the points are some of its pixels, `corners`, (4, 3), are what its corner pixels
    see: top left, top right, bottom right, bottom left. Nothing depends on the scene's own axes,
    but for a photograph of a single pixel.
    """
    center = points.mean(axis=0)
    normal = normals.mean(axis=0)
    normal /= np.linalg.norm(normal)
    grid = points.reshape(*shape, 3) if corners is None else corners[[[0, 1], [3, 2]]]
    if shape[1] > 1:
        across = (grid[:, -1] - grid[:, 0]).mean(axis=0)
    elif shape[0] > 1:
        across = np.cross(normal, (grid[-1] - grid[0]).mean(axis=0))
    else:
        across = np.cross(normal, np.eye(3)[np.abs(normal).argmin()])
    across = across - (across @ normal) * normal
    across /= np.linalg.norm(across)
    return WallFrame(center, across, normal, up=np.cross(across, -normal))


FARTHEST = 1e3
"""Distance from the origin over the longer side of what the camera sees of the wall: there single
precision makes an error of 1e-3 in A, as much as the noise of a 60 dB photograph."""


@dataclass(frozen=True, eq=False)
class Geometry:
    """A view of the wall and the hidden surfaces of one scene: all that direct light depends on.

    M is the number of pixels of the view, N the number of patches of the hidden image; both are
    row-major with row 0 at the top.

    Attributes
    ----------
    view
        What the camera sees of the wall.
    hidden
        The hidden surfaces in patches.

    Raises
    ------
    SceneError
        If the scene has no such hidden surface, single precision does not resolve the places, or
        of a hidden surface no patch faces what the camera sees of the wall.
    """

    view: View
    hidden: Hidden

    def __post_init__(self) -> None:
        for name in self.hidden:
            if name not in self.scene.emission:
                known = ", ".join(self.scene.emission)
                raise SceneError(f"scene '{self.path}' has hidden surfaces {known}, no '{name}'")
        points, normals = self.view.centers, self.view.center_normals
        rows, columns = self.view.shape
        ends = self.view.corners[1]
        corners = [ends[k] for k, size in ((1, columns), (3, rows)) if size > 1]
        sides = [float(np.linalg.norm(end - ends[0])) for end in corners]
        far = np.abs(np.concatenate([points, self.hidden.centers])).max()
        if sides and (far > FARTHEST * max(sides) or 0 in sides):
            raise SceneError(
                f"scene '{self.path}': wall or monitor are {far:.3g} from the origin, and the "
                f"camera sees {max(sides):.3g} of the wall: too far for float32. Move the scene to "
                "the origin, or widen the camera's view"
            )
        # Of a plane wall, a corner of the photograph sees what any of its pixels sees.
        points = np.concatenate([points, ends])
        normals = np.concatenate([normals, np.tile(normals.mean(axis=0), (len(ends), 1))])
        for name, surface in self.hidden.items():
            for center, normal in zip(surface.centers, surface.normals, strict=True):
                way = center - points
                if ((way @ normal < 0) & (np.sum(normals * way, axis=1) > 0)).any():
                    break
            else:
                raise SceneError(
                    f"scene '{self.path}': hidden surface '{name}' faces away from the wall that "
                    "the camera sees, or is behind it; turn it round, flip its normals "
                    "(flip_normals), or move it"
                )

    def at(self, **values: str | float) -> Self:
        """Return the same with other values for its file's ``<default>``s: `Scene.at`.

        Where things merely move, and no shape comes near the camera's view, this takes a few
        milliseconds.
        """
        scene = self.scene.at(**values)
        hidden = Hidden.of_scene(scene, self.hidden.shapes)
        return replace(self, view=self._seen(scene, self.view.across), hidden=hidden)

    def averaged(self, across: int) -> Self:
        """Return the same with each pixel averaged over so many points along each side."""
        if across == self.view.across:
            return self
        return replace(self, view=self._seen(self.scene, across))

    def _seen(self, scene: Scene, across: int) -> View:
        """Return the view of a scene in the same pixels."""
        own = self.view
        shape = own.shape if own.is_cut else None
        view = View.of(scene, shape, across=across, camera=own.camera)
        return view if own.pixels is None else view.of_pixels(own.pixels)

    def __repr__(self) -> str:
        """Return its file, sizes and parameters on one line."""
        given = "".join(f", {name}={value}" for name, value in self.parameters.items())
        rows, columns = self.photograph_shape
        sizes = f"{self.hidden.sizes} patches, {rows}x{columns} pixels"
        return (
            f"{type(self).__name__}('{self.path}', {sizes}, "
            f"{len(self.view.occluders)} occluders{given})"
        )

    @property
    def scene(self) -> Scene:
        """The scene."""
        return self.view.scene

    @property
    def document(self) -> SceneDocument:
        """The Mitsuba scene file and what it declares."""
        return self.scene.document

    @property
    def path(self) -> Path:
        """The Mitsuba scene file."""
        return self.scene.path

    @property
    def parameters(self) -> Mapping[str, str]:
        """Values given for the file's ``<default>``s."""
        return self.scene.parameters

    @property
    def photograph_shape(self) -> Size:
        """(rows, columns) of the photograph."""
        return self.view.shape

    @property
    def hidden_shape(self) -> Size:
        """(R, C) of the hidden image, of one surface."""
        return self.hidden.shape

    @property
    def channel_gain(self) -> Array:
        """(3,) or (M, 3) the wall's colour, see `View`."""
        return self.view.channel_gain

    @property
    def paint(self) -> Array:
        """(M, 1) or (1, 1) the brightness of the wall in A and B, see `View`."""
        return self.view.paint

    @property
    def transport_shape(self) -> tuple[int, int]:
        """(M, N), the shape of the light transport matrix."""
        return len(self.view.points), self.hidden.patches
