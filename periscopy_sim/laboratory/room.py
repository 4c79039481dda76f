"""The relay wall, the camera that sees it, and the hidden surfaces: their entries and text."""

from typing import TYPE_CHECKING, Annotated, ClassVar, Literal, Self

import numpy as np
from numpy.typing import NDArray
from pydantic import BeforeValidator, Field, model_validator

from periscopy_sim.errors import ConfigurationError
from periscopy_sim.laboratory import entries
from periscopy_sim.laboratory.scene_text import SceneText, paint, tag, transform
from periscopy_sim.numerics import Array
from periscopy_sim.rendering.scene_files import TriangleMesh
from periscopy_sim.scene import MONITOR
from periscopy_sim.storage.yaml_document import RowsAndColumns, Strict

WALL = {"least": 1.0, "beyond": 1.5}
"""Metres that the wall reaches at least to each side of the middle of the camera's view; its size
over that of the view: numbers may change."""

STEEP = 10.0
"""Degrees off the vertical from which on up is the top of a camera's picture."""

PLACES = ("center", "top_left", "top_right", "bottom_left", "bottom_right")
"""The places by one of which a monitor is known."""

BLACK = 0.05, 0.05, 0.05
"""Reflectance of a surface that sends its own light."""

POLE = 89.0
"""Degrees, beyond which a direction is too close to a pole of the angles."""

FACET = 1.0
"""Degrees that a facet of an angular surface spans at most. At 2.5 the facets of the doorway's room
change the light of patches of about their size by 0.14 %, more than its photographs' noise."""

TURNS = {"floor": 0, "standing": 90, "ceiling": 180}
"""Degrees about x that turn a floor into each kind of wall."""


class Wall(Strict):
    """The relay wall, painted evenly, which stands or lies.

    `axes` are those along it, to the right and to the top of a picture that shows it squarely or,
    of a ceiling, to its bottom; `depth` is the other one. `measure` names the entry that is its
    place there.
    """

    axes: ClassVar[str] = "xz"
    depth: ClassVar[str] = "y"
    measure: ClassVar[str] = "distance"
    reflectance: entries.Reflectance = (0.8, 0.8, 0.8)
    if TYPE_CHECKING:
        kind: str

    @property
    def place(self) -> entries.Measured:
        """Return its place along `depth`."""
        place: entries.Measured = getattr(self, self.measure)
        return place

    def add_to(self, scene: SceneText, view: Array) -> None:
        """Add the wall, which reaches beyond the camera's view of it."""
        low, high = view.min(axis=0), view.max(axis=0)
        middle = map(float, np.round((low + high) / 2, 2))
        half = max(WALL["least"], float(np.ceil(50 * WALL["beyond"] * np.max(high - low)) / 100))
        scene.section(f"The wall: its {self.depth}.")
        place = scene.declare(f"wall_{self.measure}", self.place, "length", f"wall.{self.measure}")
        turned = [tag("rotate", x=1, angle=TURNS[self.kind])] * (self.kind != "floor")
        moved = tag("translate", **dict(zip(self.axes, middle, strict=True)), **{self.depth: place})
        to_world = transform(tag("scale", value=half), *turned, moved)
        scene.add("rectangle", "wall", to_world, paint(self.reflectance))


class StandingWall(Wall):
    """The plane y = distance, behind the room."""

    kind: Literal["standing"]
    distance: entries.Size


class LyingWall(Wall):
    """The plane z = height: a floor below the room, or a ceiling above it."""

    axes: ClassVar[str] = "xy"
    depth: ClassVar[str] = "z"
    measure: ClassVar[str] = "height"
    kind: Literal["floor", "ceiling"]
    height: entries.Length


AnyWall = Annotated[
    StandingWall | LyingWall,
    Field(discriminator="kind"),
    BeforeValidator(lambda wall: {"kind": "standing"} | wall if isinstance(wall, dict) else wall),
]


class PerspectiveCamera(Strict):
    """A camera in the room: its place, the point of the wall that it looks at, how wide it sees."""

    kind: Literal["perspective"]
    film: RowsAndColumns
    position: entries.Place
    target: entries.OnWall
    roll: entries.Angle = entries.exactly(0.0)
    field_of_view: entries.Angle

    @model_validator(mode="after")
    def _sees_something(self) -> Self:
        if not 0 < self.field_of_view.value < 180:
            raise ValueError("give a field_of_view, of the picture's width, between 0 and 180 deg")
        return self

    def line_of_sight(self, wall: AnyWall) -> tuple[Array, Array, Array]:
        """Return the camera's place, the wall's point that it looks at, and the top of its picture.

        The top is up. For a camera that looks straight down the top is y, and straight up -y, as
        someone who stands facing along y sees it.
        """
        position = np.array([each.value for each in self.position])
        along = {**dict(zip(wall.axes, self.target, strict=True)), wall.depth: wall.place}
        target = np.array([along[axis].value for axis in "xyz"])
        down = (position - target)[2] / np.linalg.norm(position - target)
        is_steep = abs(down) > np.cos(np.radians(STEEP))
        return position, target, np.array([0, np.sign(down), 0] if is_steep else [0, 0, 1])

    def corners_seen(self, wall: AnyWall) -> Array:
        """Return the wall's points in the corners of the picture, (4, 2), along the wall's axes.

        They are top left, top right, bottom right, bottom left, as the camera sees them. A
        `ConfigurationError` says that the picture does not end on the wall.
        """
        position, target, top = self.line_of_sight(wall)
        ahead = (target - position) / np.linalg.norm(target - position)
        across = np.cross(ahead, top)
        across /= np.linalg.norm(across)
        up = np.cross(across, ahead)
        c, s = np.cos(np.radians(self.roll.value)), np.sin(np.radians(self.roll.value))
        across, up = c * across - s * up, s * across + c * up  # a positive roll is clockwise
        half = np.tan(np.radians(self.field_of_view.value) / 2)
        tall = half * self.film[0] / self.film[1]
        rays = ahead + np.array([[-half], [half], [half], [-half]]) * across
        rays += np.array([[tall], [tall], [-tall], [-tall]]) * up
        depth = "xyz".index(wall.depth)
        towards = -rays[:, depth] if wall.kind == "floor" else rays[:, depth]
        if towards.min() <= 1e-3 * np.linalg.norm(rays, axis=1).max():
            raise ConfigurationError(
                "camera: a corner of its picture shows what is beyond the wall's horizon; turn it "
                "more towards the wall, or make its field of view smaller"
            )
        reach = (wall.place.value - position[depth]) / rays[:, depth]
        points = position + reach[:, np.newaxis] * rays
        return np.asarray(points[:, ["xyz".index(axis) for axis in wall.axes]])

    def add_to(self, scene: SceneText, wall: AnyWall) -> None:
        """Add the camera, aimed at a point of the wall."""
        scene.section("The camera: its place, the wall's point that it looks at, how wide it sees.")
        scene.place("camera", self.position, "camera.position")
        rolled = scene.declare("camera_roll", self.roll, "angle", "camera.roll")
        scene.place("target", self.target, "camera.target", wall.axes)
        names = {axis: f"$target_{axis}" for axis in wall.axes}
        names[wall.depth] = f"$wall_{wall.measure}"
        eye, point = "$camera_x, $camera_y, $camera_z", ", ".join(names[axis] for axis in "xyz")
        fov = scene.declare("field_of_view", self.field_of_view, "angle", "camera.field_of_view")
        top = ", ".join(f"{each:g}" for each in self.line_of_sight(wall)[2])
        to_world = transform(
            tag("rotate", z=1, angle=rolled), tag("lookat", origin=eye, target=point, up=top)
        )
        lens = tag("float", name="fov", value=fov), tag("string", name="fov_axis", value="x")
        scene.add_camera("perspective", self.film, *lens, to_world)


class RectifiedCamera(Strict):
    """A picture that was brought to an upright rectangle of the wall."""

    kind: Literal["rectified"]
    film: RowsAndColumns
    bottom_left: entries.OnWall
    width: entries.Size
    height: entries.Size

    def corners_seen(self, wall: AnyWall) -> Array:
        """Return the rectangle's corners, (4, 2), as of a `PerspectiveCamera`."""
        x, z = (each.value for each in self.bottom_left)
        right, height = x + self.width.value, self.height.value
        high = z - height if wall.kind == "ceiling" else z + height
        return np.array([(x, high), (right, high), (right, z), (x, z)])

    def add_to(self, scene: SceneText, wall: AnyWall) -> None:
        """Add the camera, squarely before the rectangle; its own x runs to the left."""
        scene.section("What the rectified picture shows of the wall, from its lower left corner.")
        place = scene.place("view", self.bottom_left, "camera.bottom_left", wall.axes)
        width = scene.declare("view_width", self.width, "length", "camera.width")
        height = scene.declare("view_height", self.height, "length", "camera.height")
        turn = TURNS[wall.kind] - TURNS["standing"]
        to_world = transform(
            tag("scale", y=self.film[1] / self.film[0]),
            tag("translate", x=-1, y=1),
            tag("scale", x=0.5, y=0.5),
            tag("scale", x=width, y=height),
            tag("lookat", origin="0, -0.05, 0", target="0, 0, 0", up="0, 0, 1"),
            *[tag("rotate", x=1, angle=turn)] * (turn != 0),
            place,
            tag("translate", **{wall.depth: f"$wall_{wall.measure}"}),
        )
        near = tag("float", name="near_clip", value=0.001)
        scene.add_camera("orthographic", self.film, to_world, near)


AnyCamera = Annotated[PerspectiveCamera | RectifiedCamera, Field(discriminator="kind")]


class Falloff(Strict):
    """Exponents of the cosines of the vertical and the horizontal angle."""

    vertical: entries.Exponent
    horizontal: entries.Exponent


class _Rectangle(Strict):
    """A rectangle, and the place of its centre or of one corner.

    Corners are those that a viewer who faces it sees.
    """

    width: entries.Size
    height: entries.Size
    center: entries.Place | None = None
    top_left: entries.Place | None = None
    top_right: entries.Place | None = None
    bottom_left: entries.Place | None = None
    bottom_right: entries.Place | None = None
    turn: entries.Angle = entries.exactly(0.0)
    tilt: entries.Angle = entries.exactly(0.0)

    @model_validator(mode="after")
    def _has_one_place(self) -> Self:
        if sum(getattr(self, name) is not None for name in PLACES) != 1:
            raise ValueError(f"give one of {', '.join(PLACES)}: [x, y, z]")
        return self

    def _to_world(self, scene: SceneText, name: str) -> str:
        """Declare the numbers of a surface of an id; return its place."""
        where, place = next((e, place) for e in PLACES if (place := getattr(self, e)))
        what = "The lit part of the monitor" if name == MONITOR else f"The hidden surface '{name}'"
        scene.section(
            f"{what}: its size, the place of its {where.replace('_', ' ')} as a viewer sees it, "
            "how it is tilted and turned there; at 0 it faces along y."
        )
        width = scene.declare(f"{name}_width", self.width, "length", f"{name}.width")
        height = scene.declare(f"{name}_height", self.height, "length", f"{name}.height")
        to_place = scene.place(name, place, f"{name}.{where}")
        turns = scene.turns(name, self.tilt, self.turn, name)
        across = {"left": 1, "right": -1}.get(where.partition("_")[2], 0)
        up = {"top": -1, "bottom": 1}.get(where.partition("_")[0], 0)
        return transform(
            tag("translate", x=across, y=up),
            tag("scale", x=0.5, y=0.5),
            tag("scale", x=width, y=height),
            tag("rotate", x=1, angle=90),  # Mitsuba's rectangle: u to a viewer's right, v up
            tag("rotate", z=1, angle=180),
            *turns,
            to_place,
        )


class Screen(_Rectangle):
    """The lit part of a monitor."""

    falloff: Falloff | None = None

    def add_to(self, scene: SceneText, name: str) -> None:
        """Add the surface, of an id."""
        to_world = self._to_world(scene, name)
        kind, emitter = "area", [tag("rgb", name="radiance", value=1)]
        if self.falloff is not None:
            kind, own = "lcd", "" if name == MONITOR else f"{name}_"
            scene.section(
                f"Its falloff with angle: radiance over the normal's is cos^{own}vertical_exponent "
                f"of the vertical angle times cos^{own}horizontal_exponent of the horizontal one."
            )
            for each in ("vertical", "horizontal"):
                measured, key = getattr(self.falloff, each), f"{each}_exponent"
                exponent = scene.declare(f"{own}{key}", measured, "number", f"{name}.{each}")
                emitter.append(tag("float", name=key, value=exponent))
        inside = "\n    ".join(emitter)
        lit = f'<emitter type="{kind}">\n    {inside}\n</emitter>'
        scene.add("rectangle", name, to_world, lit, paint(BLACK))


class _HiddenSurface(Strict):
    """Name of all hidden surfaces of the list; the scene has it after ``hidden_``."""

    name: entries.Name


class HiddenScreen(Screen, _HiddenSurface):
    """One of several screens."""

    kind: Literal["screen"]


class Card(_Rectangle, _HiddenSurface):
    """A matte rectangle that other light falls on: it is recovered as the light that it sends."""

    kind: Literal["card"]
    reflectance: entries.Reflectance = (0.8, 0.8, 0.8)

    def add_to(self, scene: SceneText, name: str) -> None:
        """Add the surface, of an id."""
        scene.add("rectangle", name, self._to_world(scene, name), paint(self.reflectance))


class AngularSurface(_HiddenSurface):
    """Directions about a point, as part of a sphere; all of its numbers are choices.

    Azimuths are counterclockwise from x as seen from above, elevations above the horizontal; a
    `projected` elevation is that of the direction's projection on the plane y = 0, as a lintel
    along y separates it. Both are taken before the surface is turned.
    """

    kind: Literal["angular"]
    position: tuple[entries.ChosenLength, entries.ChosenLength, entries.ChosenLength]
    radius: entries.ChosenSize
    azimuth: tuple[entries.ChosenAngle, entries.ChosenAngle]
    elevation: tuple[entries.ChosenAngle, entries.ChosenAngle]
    projected: bool = False
    turn: entries.ChosenAngle = entries.exactly(0.0)

    @model_validator(mode="after")
    def _is_part_of_a_sphere(self) -> Self:
        azimuth, elevation = self.degrees
        steep = np.abs([*elevation, *(azimuth if self.projected else ())]).max() > POLE
        if not (0 < np.diff(azimuth) < 360 and np.diff(elevation) > 0) or steep:
            raise ValueError(
                f"angular surface '{self.name}': give [from, to] that increase, an azimuth of less "
                f"than a full turn, elevations (and azimuths, if projected) within {POLE:g} deg"
            )
        return self

    @property
    def degrees(self) -> NDArray[np.float64]:
        """Return the ends of azimuth and elevation, (2, 2), in degrees."""
        return np.array([[end.value for end in each] for each in (self.azimuth, self.elevation)])

    def add_to(self, scene: SceneText, name: str) -> None:
        """Add the directions, of an id."""
        scene.section(
            f"The directions '{name}', as part of a sphere: its middle, how it is turned, its "
            "radius. The radius is a choice: past an edge a photograph shows directions, hardly "
            "distances."
        )
        to_place = scene.place(name, self.position, name)
        turn = scene.declare(f"{name}_turn", self.turn, "angle", f"{name}: turn")
        radius = scene.declare(f"{name}_radius", self.radius, "length", f"{name}: radius")
        to_world = transform(tag("scale", value=radius), tag("rotate", z=1, angle=turn), to_place)
        scene.add("ply", name, *scene.mesh(name, self._on_unit_sphere()), to_world, paint(BLACK))

    def _on_unit_sphere(self) -> TriangleMesh:
        """Return the surface on the unit sphere; UV runs by its angles, as seen from within."""
        (right, left), (low, high) = np.radians(self.degrees)
        columns, rows = np.ceil(np.ptp(self.degrees, axis=1) / FACET).astype(int)
        row, column = np.indices((rows + 1, columns + 1)).reshape(2, -1)
        u, v = column / columns, row / rows
        azimuth, elevation = left + u * (right - left), low + v * (high - low)
        if self.projected:
            directions = np.stack([np.ones(len(u)), np.tan(azimuth), np.tan(elevation)], axis=1)
            directions /= np.linalg.norm(directions, axis=1, keepdims=True)
        else:
            level = np.stack([np.cos(azimuth), np.sin(azimuth)]) * np.cos(elevation)
            directions = np.stack([*level, np.sin(elevation)], axis=1)
        first = np.arange(len(u)).reshape(rows + 1, -1)[:-1, :-1].ravel()
        above = first + columns + 1
        halves = [first, first + 1, above + 1], [first, above + 1, above]
        return TriangleMesh(directions, np.hstack(halves).T, np.stack([u, v], axis=1))


HiddenSurface = Annotated[HiddenScreen | Card | AngularSurface, Field(discriminator="kind")]
