"""The text of a scene: measured numbers as ``<default>``s, and the shapes and camera they place.

Mitsuba's XML has no arithmetic, but transforms: half of a width is a scaling by one half, and minus
half of it a scaling by -2, a shift by the width, and a scaling by -1/2.
"""

from collections.abc import Iterable, Mapping
from textwrap import indent, wrap
from xml.sax.saxutils import quoteattr

import numpy as np

from periscopy_sim.errors import ConfigurationError
from periscopy_sim.laboratory import document
from periscopy_sim.numerics import Array
from periscopy_sim.rendering.scene_files import comment, literal
from periscopy_sim.scene import MONITOR

HEAD = """<!-- {title}
     Metres and degrees; x to the right as one looks along y, to a wall that stands, and z up.
     Turns are about the vertical, counterclockwise from above; tilts about x, the top away from the
     wall. NAME_error is the standard deviation of NAME, in its unit: how far off the ruler may be.
     -->
<scene version="3.0.0">
"""

FILM = """<film type="hdrfilm">
    <integer name="width" value="$width"/>
    <integer name="height" value="$height"/>
    <rfilter type="box"/>
</film>
<sampler type="independent"/>"""


class SceneText:
    """The text of a scene as it grows: first the measured numbers, then shapes and sensor."""

    def __init__(self, laboratory: document.Laboratory) -> None:
        self._errors = {
            "length": laboratory.errors.length,
            "angle": laboratory.errors.angle,
            "number": document.Measured(0.0),
        }
        self._without_error: list[str] = []
        self._defaults: list[str] = []
        self._names: set[str] = set()
        self._elements: list[str] = []

    def section(self, title: str) -> None:
        """Begin the measured numbers of one thing."""
        lines = wrap(f"<!-- {comment(title)} -->", 95, subsequent_indent="     ")
        self._defaults += ["", *(f"    {line}" for line in lines)]

    def declare(self, name: str, measured: document.Measured, kind: str, entry: str) -> str:
        """Declare a number and its error; return the reference to it.

        The kind is ``length``, ``angle`` or ``number``, `entry` its name in the document.
        """
        default = self._errors[kind]
        if measured.error is None and default is None:
            self._without_error.append(entry)
        error = default.value if measured.error is None and default else measured.error or 0.0
        if {name, f"{name}_error"} & self._names:
            raise ConfigurationError(f"{entry}: two numbers of the scene would be called '{name}'")
        self._default(name, measured.value)
        if error > 0:
            self._default(f"{name}_error", error)
        return f"${name}"

    def place(
        self, name: str, point: Iterable[document.Measured], entry: str, axes: str = "xyz"
    ) -> str:
        """Declare a point's coordinates; return the tag that moves there from the origin."""
        shifts = {
            axis: self.declare(f"{name}_{axis}", each, "length", f"{entry}.{axis}")
            for axis, each in zip(axes, point, strict=True)
        }
        return tag("translate", **shifts)

    def turns(
        self, name: str, tilt: document.Measured, turn: document.Measured, entry: str
    ) -> list[str]:
        """Declare a tilt about x and then a turn about z; return their tags."""
        tilted = self.declare(f"{name}_tilt", tilt, "angle", f"{entry}: tilt")
        turned = self.declare(f"{name}_turn", turn, "angle", f"{entry}: turn")
        return [tag("rotate", x=1, angle=tilted), tag("rotate", z=1, angle=turned)]

    def add(self, kind: str, name: str, *parts: str, element: str = "shape") -> None:
        """Add a shape, or another element, of a type and an id, made of parts."""
        inside = indent("\n".join(filter(None, parts)), "    ")
        text = f'<{element} type="{kind}" id="{name}">\n{inside}\n</{element}>'
        self._elements.append("\n" + indent(text, "    "))

    def add_camera(self, kind: str, size: tuple[int, int], *parts: str) -> None:
        """Add the camera, with a film of (rows, columns)."""
        self.section("Rows and columns of the photograph.")
        rows, columns = size
        if rows == columns:
            self._default("film", rows)
        self._default("height", "$film" if rows == columns else rows)
        self._default("width", "$film" if rows == columns else columns)
        self.add(kind, "camera", *parts, FILM, element="sensor")

    def text(self, title: str) -> str:
        """Return the whole scene; a ConfigurationError lists the numbers without an error."""
        if self._without_error:
            raise ConfigurationError(
                f"{', '.join(self._without_error)}: no error is given; write '12.5 cm +- 3 mm', or "
                "the error of all such numbers: 'errors: {length: 5 mm, angle: 1 deg}'"
            )
        lines = [*self._defaults, "", '    <integrator type="path"/>', *self._elements, "</scene>"]
        return HEAD.format(title=comment(title)) + "\n".join(lines[1:]) + "\n"

    def _default(self, name: str, value: float | str) -> None:
        self._names.add(name)
        self._defaults.append("    " + tag("default", name=name, value=value))


def tag(kind: str, **attributes: object) -> str:
    """Return an empty element."""
    words = [kind, *(f"{name}={quoteattr(str(value))}" for name, value in attributes.items())]
    return f"<{' '.join(words)}/>"


def transform(*tags: str) -> str:
    """Return the place of a shape or sensor: its tags act one after the other."""
    inside = indent("\n".join(tags), "    ")
    return f'<transform name="to_world">\n{inside}\n</transform>'


def paint(reflectance: tuple[float, float, float]) -> str:
    """Return a diffuse surface."""
    values = reflectance[:1] if len(set(reflectance)) == 1 else reflectance
    colour = tag("rgb", name="reflectance", value=", ".join(map(repr, values)))
    return f'<bsdf type="diffuse">\n    {colour}\n</bsdf>'


STEEP = 10.0
"""Degrees off the vertical from which on up is the top of a camera's picture."""


def line_of_sight(
    camera: document.PerspectiveCamera, wall: document.AnyWall
) -> tuple[Array, Array, Array]:
    """Return a camera's place, the wall's point that it looks at, and the top of its picture.

    The top is up. For a camera that looks straight down the top is y, and straight up -y, as
    someone who stands facing along y sees it.
    """
    position = np.array([each.value for each in camera.position])
    along = {**dict(zip(wall.axes, camera.target, strict=True)), wall.depth: wall.place}
    target = np.array([along[axis].value for axis in "xyz"])
    down = (position - target)[2] / np.linalg.norm(position - target)
    is_steep = abs(down) > np.cos(np.radians(STEEP))
    return position, target, np.array([0, np.sign(down), 0] if is_steep else [0, 0, 1])


def corners_seen(
    camera: document.PerspectiveCamera | document.RectifiedCamera, wall: document.AnyWall
) -> Array:
    """Return the wall's points in the corners of a camera's picture, (4, 2), along the wall's axes.

    They are top left, top right, bottom right, bottom left, as the camera sees them. A
    `ConfigurationError` says that the picture does not end on the wall.
    """
    if isinstance(camera, document.RectifiedCamera):
        x, z = (each.value for each in camera.bottom_left)
        right, height = x + camera.width.value, camera.height.value
        high = z - height if wall.kind == "ceiling" else z + height
        return np.array([(x, high), (right, high), (right, z), (x, z)])
    position, target, top = line_of_sight(camera, wall)
    ahead = (target - position) / np.linalg.norm(target - position)
    across = np.cross(ahead, top)
    across /= np.linalg.norm(across)
    up = np.cross(across, ahead)
    c, s = np.cos(np.radians(camera.roll.value)), np.sin(np.radians(camera.roll.value))
    across, up = c * across - s * up, s * across + c * up  # a positive roll is clockwise
    half = np.tan(np.radians(camera.field_of_view.value) / 2)
    tall = half * camera.film[0] / camera.film[1]
    rays = ahead + np.array([[-half], [half], [half], [-half]]) * across
    rays += np.array([[tall], [tall], [-tall], [-tall]]) * up
    depth = "xyz".index(wall.depth)
    towards = -rays[:, depth] if wall.kind == "floor" else rays[:, depth]
    if towards.min() <= 1e-3 * np.linalg.norm(rays, axis=1).max():
        raise ConfigurationError(
            "camera: a corner of its picture shows what is beyond the wall's horizon; turn it more "
            "towards the wall, or make its field of view smaller"
        )
    reach = (wall.place.value - position[depth]) / rays[:, depth]
    points = position + reach[:, np.newaxis] * rays
    return np.asarray(points[:, ["xyz".index(axis) for axis in wall.axes]])


WALL = {"least": 1.0, "beyond": 1.5}
"""Metres that the wall reaches at least to each side of the middle of the camera's view; its size
over that of the view: numbers may change."""

CYLINDER = "cylinder"
"""Name of the mesh that cylinders share."""

FLAT = tag("boolean", name="face_normals", value="true")
"""Says that a mesh has no normals but its faces'."""


def scene_text(laboratory: document.Laboratory, meshes: Mapping[str, str], title: str) -> str:
    """Return the XML of a laboratory; its comment begins with a title.

    `meshes` maps the name of each occluder that is a mesh, the id of each angular surface, and
    `CYLINDER`, to its file beside the scene. Numbers without an error are a `ConfigurationError`.
    """
    scene, camera, wall = SceneText(laboratory), laboratory.camera, laboratory.wall
    _add_wall(scene, wall, corners_seen(camera, wall))
    if isinstance(camera, document.RectifiedCamera):
        _add_rectified(scene, camera, wall)
    else:
        _add_camera(scene, camera, wall)
    if laboratory.monitor is not None:
        _add_rectangle(scene, MONITOR, laboratory.monitor)
    for surface in laboratory.hidden:
        if isinstance(surface, document.AngularSurface):
            _add_angular(scene, surface, meshes[surface.id])
        else:
            _add_rectangle(scene, surface.id, surface)
    to_world: dict[str, list[str]] = {"": []}  # from each occluder's own coordinates
    for body in laboratory.occluders:
        add = _add_rod if isinstance(body, document.Rod) else _add_body
        to_world[body.name] = add(scene, body, to_world[body.bearer], meshes)  # type: ignore[arg-type]
    return scene.text(title)


def _add_wall(scene: SceneText, wall: document.AnyWall, view: Array) -> None:
    """Add a wall that reaches beyond the camera's view of it."""
    low, high = view.min(axis=0), view.max(axis=0)
    middle = map(float, np.round((low + high) / 2, 2))
    half = max(WALL["least"], float(np.ceil(50 * WALL["beyond"] * np.max(high - low)) / 100))
    scene.section(f"The wall: its {wall.depth}.")
    entry = f"wall.{wall.measure}"
    place = scene.declare(f"wall_{wall.measure}", wall.place, "length", entry)
    turned = [tag("rotate", x=1, angle=document.TURNS[wall.kind])] * (wall.kind != "floor")
    moved = tag("translate", **dict(zip(wall.axes, middle, strict=True)), **{wall.depth: place})
    to_world = transform(tag("scale", value=half), *turned, moved)
    scene.add("rectangle", "wall", to_world, paint(wall.reflectance))


def _add_camera(
    scene: SceneText, camera: document.PerspectiveCamera, wall: document.AnyWall
) -> None:
    scene.section("The camera: its place, the wall's point that it looks at, how wide it sees.")
    scene.place("camera", camera.position, "camera.position")
    rolled = scene.declare("camera_roll", camera.roll, "angle", "camera.roll")
    scene.place("target", camera.target, "camera.target", wall.axes)
    names = {**{axis: f"$target_{axis}" for axis in wall.axes}, wall.depth: f"$wall_{wall.measure}"}
    eye, point = "$camera_x, $camera_y, $camera_z", ", ".join(names[axis] for axis in "xyz")
    fov = scene.declare("field_of_view", camera.field_of_view, "angle", "camera.field_of_view")
    top = ", ".join(f"{each:g}" for each in line_of_sight(camera, wall)[2])
    to_world = transform(
        tag("rotate", z=1, angle=rolled), tag("lookat", origin=eye, target=point, up=top)
    )
    lens = tag("float", name="fov", value=fov), tag("string", name="fov_axis", value="x")
    scene.add_camera("perspective", camera.film, *lens, to_world)


def _add_rectified(
    scene: SceneText, camera: document.RectifiedCamera, wall: document.AnyWall
) -> None:
    """See a rectangle of the wall squarely; the camera's own x runs to the left."""
    scene.section("What the rectified picture shows of the wall, from its lower left corner.")
    place = scene.place("view", camera.bottom_left, "camera.bottom_left", wall.axes)
    width = scene.declare("view_width", camera.width, "length", "camera.width")
    height = scene.declare("view_height", camera.height, "length", "camera.height")
    turn = document.TURNS[wall.kind] - document.TURNS["standing"]
    to_world = transform(
        tag("scale", y=camera.film[1] / camera.film[0]),
        tag("translate", x=-1, y=1),
        tag("scale", x=0.5, y=0.5),
        tag("scale", x=width, y=height),
        tag("lookat", origin="0, -0.05, 0", target="0, 0, 0", up="0, 0, 1"),
        *[tag("rotate", x=1, angle=turn)] * (turn != 0),
        place,
        tag("translate", **{wall.depth: f"$wall_{wall.measure}"}),
    )
    near = tag("float", name="near_clip", value=0.001)
    scene.add_camera("orthographic", camera.film, to_world, near)


def _add_rectangle(scene: SceneText, name: str, surface: document.Screen | document.Card) -> None:
    """Add the monitor or another flat surface of an id."""
    where, place = next((name, place) for name, place in surface.places.items() if place)
    what = "The lit part of the monitor" if name == MONITOR else f"The hidden surface '{name}'"
    scene.section(
        f"{what}: its size, the place of its {where.replace('_', ' ')} as a viewer sees it, how it "
        "is tilted and turned there; at 0 it faces along y."
    )
    width = scene.declare(f"{name}_width", surface.width, "length", f"{name}.width")
    height = scene.declare(f"{name}_height", surface.height, "length", f"{name}.height")
    to_place = scene.place(name, place, f"{name}.{where}")
    turns = scene.turns(name, surface.tilt, surface.turn, name)
    across = {"left": 1, "right": -1}.get(where.partition("_")[2], 0)
    up = {"top": -1, "bottom": 1}.get(where.partition("_")[0], 0)
    to_world = transform(
        tag("translate", x=across, y=up),
        tag("scale", x=0.5, y=0.5),
        tag("scale", x=width, y=height),
        tag("rotate", x=1, angle=90),  # Mitsuba's rectangle: its u to a viewer's right, its v up
        tag("rotate", z=1, angle=180),
        *turns,
        to_place,
    )
    if isinstance(surface, document.Card):
        scene.add("rectangle", name, to_world, paint(surface.reflectance))
        return
    kind, emitter = "area", [tag("rgb", name="radiance", value=1)]
    if surface.falloff is not None:
        kind, own = "lcd", "" if name == MONITOR else f"{name}_"
        scene.section(
            f"Its falloff with angle: radiance over the normal's is cos^{own}vertical_exponent of "
            f"the vertical angle times cos^{own}horizontal_exponent of the horizontal one."
        )
        for each in ("vertical", "horizontal"):
            measured, key = getattr(surface.falloff, each), f"{each}_exponent"
            exponent = scene.declare(f"{own}{key}", measured, "number", f"{name}.{each}")
            emitter.append(tag("float", name=key, value=exponent))
    inside = "\n    ".join(emitter)
    lit = f'<emitter type="{kind}">\n    {inside}\n</emitter>'
    scene.add("rectangle", name, to_world, lit, paint((0.05, 0.05, 0.05)))


def _add_angular(scene: SceneText, surface: document.AngularSurface, file: str) -> None:
    """Add directions about a point, of which a file has the part of the unit sphere."""
    name = surface.id
    scene.section(
        f"The directions '{name}', as part of a sphere: its middle, how it is turned, its radius. "
        "The radius is a choice: past an edge a photograph shows directions, hardly distances."
    )
    to_place = scene.place(name, surface.position, name)
    turn = scene.declare(f"{name}_turn", surface.turn, "angle", f"{name}: turn")
    radius = scene.declare(f"{name}_radius", surface.radius, "length", f"{name}: radius")
    to_world = transform(tag("scale", value=radius), tag("rotate", z=1, angle=turn), to_place)
    mesh = tag("string", name="filename", value=literal(file)), FLAT
    scene.add("ply", name, *mesh, to_world, paint((0.05, 0.05, 0.05)))


def _placed(body: document.Occluding, measured: document.Measured) -> document.Measured:
    """Return a place or turn; one without an error is exact if another occluder bears this one."""
    return document.exactly(measured.value) if body.bearer and measured.error is None else measured


def _beside(body: document.Occluding) -> str:
    return f", in the coordinates of '{body.bearer}'" if body.bearer else ""


def _add_rod(
    scene: SceneText, body: document.Rod, bearer: list[str], _: Mapping[str, str]
) -> list[str]:
    """Add a rod, given its bearer's tags to the world; return these."""
    name, entry = body.name, f"occluder '{body.name}'"
    scene.section(f"The rod '{name}': its ends{_beside(body)}, and its radius.")
    for end, point in (("start", body.start), ("end", body.end)):
        measured = [_placed(body, each) for each in point]
        scene.place(f"{name}_{end}", measured, f"{entry}: {end}")
    value, error = body.diameter.value, body.diameter.error
    radius = document.Measured(value / 2, None if error is None else error / 2)
    declared = scene.declare(f"{name}_radius", radius, "length", f"{entry}: diameter")
    ends = [
        tag("point", name=p, value=f"${name}_{end}_x, ${name}_{end}_y, ${name}_{end}_z")
        for p, end in (("p0", "start"), ("p1", "end"))
    ]
    thickness = tag("float", name="radius", value=declared)
    to_world = transform(*bearer) if bearer else ""
    scene.add("cylinder", name, *ends, thickness, to_world, paint(body.reflectance))
    return bearer


ANCHORS = {"base": (0, 0, 1), "corner": (1, 1, 1), "center": (0, 0, 0), "end": (1, 0, 1)}
"""Middle of a cube of side 2 whose anchor is the origin."""


def _add_body(
    scene: SceneText,
    body: document.Box
    | document.Plate
    | document.Frame
    | document.UprightCylinder
    | document.Edge
    | document.Doorway
    | document.MeshBody,
    bearer: list[str],
    meshes: Mapping[str, str],
) -> list[str]:
    """Add an occluder, given its bearer's tags to the world; return its own tags to the world."""
    name, entry, anchor = body.name, f"occluder '{body.name}'", getattr(body, "anchor", "base")
    scene.section(
        f"The {body.kind} '{name}': the place of its {anchor}, its tilt and turn there"
        f"{_beside(body)}."
    )
    position = [_placed(body, each) for each in body.position]
    place = scene.place(name, position, f"{entry}: position")
    turns = scene.turns(name, _placed(body, body.tilt), _placed(body, body.turn), entry)
    to_world = [*turns, place, *bearer]

    def size(which: str) -> str:
        return scene.declare(f"{name}_{which}", getattr(body, which), "length", f"{entry}: {which}")

    def add_mesh(mesh: str, *shaping: str) -> None:
        file = tag("string", name="filename", value=literal(meshes[mesh]))
        scene.add("ply", name, file, FLAT, transform(*shaping, *to_world), paint(body.reflectance))

    def add_cube(label: str, *shaping: str) -> None:
        scene.add("cube", label, transform(*shaping, *to_world), paint(body.reflectance))

    def add_block(label: str, middle: tuple[int, ...], sizes: tuple[str, ...]) -> None:
        """Add a box, or without a thickness a plane; `middle` is that of one of side 2."""
        moved = tag("translate", **dict(zip("xyz", middle, strict=True)))
        scaled = {axis: each for axis, each in zip("xyz", sizes, strict=True) if each}
        shaping = moved, tag("scale", value=0.5), tag("scale", **scaled)
        if len(scaled) == 3:
            add_cube(label, *shaping)
        else:
            to_plane = transform(tag("rotate", x=1, angle=90), *shaping, *to_world)
            scene.add("rectangle", label, to_plane, paint(body.reflectance))

    if isinstance(body, document.MeshBody):
        add_mesh(name)
    elif isinstance(body, document.UprightCylinder):
        shaping = [tag("translate", z=-0.5)] if anchor == "center" else []
        across = size("diameter")
        add_mesh(CYLINDER, *shaping, tag("scale", x=across, y=across, z=size("height")))
    elif isinstance(body, document.Frame):
        sizes = [size(which) for which in ("width", "thickness", "height", "bar")]
        for side, bar in _bars(*sizes).items():
            add_cube(f"{name}_{side}", *bar)
    elif isinstance(body, document.Doorway):
        wide = {1: size("width"), -1: size("jamb")}
        high = {1: size("lintel"), -1: size("height")}
        thick = size("thickness") if body.thickness else ""
        for part, (x, z) in document.DOORWAY.items():
            add_block(f"{name}_{part}", (x, 0, z), (wide[x], thick, high[z]))
    else:
        deep = "depth" if isinstance(body, document.Box) else "thickness"
        width, height = size("width"), size("height")
        thick = size(deep) if getattr(body, deep) else ""
        add_block(name, ANCHORS[anchor], (width, thick, height))
    return to_world


def _bars(width: str, thickness: str, height: str, bar: str) -> dict[str, tuple[str, ...]]:
    """Return how Mitsuba's cube, of side 2, becomes each bar of a frame that stands on z = 0."""
    shrink, moved = tag("scale", value=0.5), tag("translate", x=width)
    upright = shrink, tag("scale", x=bar, y=thickness, z=height)
    lying = shrink, tag("scale", x=width, y=thickness, z=bar)
    return {
        "left": (
            tag("translate", x=1, z=1), *upright, tag("scale", x=-2), moved, tag("scale", x=-0.5)
        ),
        "right": (
            tag("translate", x=-1, z=1), *upright, tag("scale", x=2), moved, tag("scale", x=0.5)
        ),
        "bottom": (tag("translate", z=1), *lying),
        "top": (tag("translate", z=-1), *lying, tag("translate", z=height)),
    }  # fmt: skip
