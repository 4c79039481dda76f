"""The wall, the camera, the monitor and the occluders of a measured laboratory, as a scene's text.

Mitsuba's XML has no arithmetic, but transforms: half of a width is a scaling by one half, and minus
half of it a scaling by -2, a shift by the width, and a scaling by -1/2.
"""

from collections.abc import Mapping

import numpy as np

from periscopy_sim.errors import ConfigurationError
from periscopy_sim.laboratory.document import (
    Box,
    Frame,
    Laboratory,
    Measured,
    MeshBody,
    Occluding,
    PerspectiveCamera,
    RectifiedCamera,
    Rod,
    UprightCylinder,
    exactly,
)
from periscopy_sim.laboratory.scene_text import SceneText, paint, tag, transform
from periscopy_sim.numerics import Array
from periscopy_sim.rendering.scene.document import literal
from periscopy_sim.scene import MONITOR


def corners_seen(camera: PerspectiveCamera | RectifiedCamera, distance: float) -> Array:
    """Return x and z of the wall's points in the corners of a camera's picture, (4, 2).

    They are top left, top right, bottom right, bottom left, as the camera sees them, on the wall y
    = `distance`. A `ConfigurationError` says that the picture does not end on the wall.
    """
    if isinstance(camera, RectifiedCamera):
        x, z = (each.value for each in camera.bottom_left)
        right, top = x + camera.width.value, z + camera.height.value
        return np.array([(x, top), (right, top), (right, z), (x, z)])
    position = np.array([each.value for each in camera.position])
    x, z = (each.value for each in camera.target)
    ahead = np.array([x, distance, z]) - position
    ahead /= np.linalg.norm(ahead)
    across = np.cross(ahead, [0.0, 0.0, 1.0])
    across /= np.linalg.norm(across)
    up = np.cross(across, ahead)
    c, s = np.cos(np.radians(camera.roll.value)), np.sin(np.radians(camera.roll.value))
    across, up = c * across - s * up, s * across + c * up  # a positive roll is clockwise
    half = np.tan(np.radians(camera.field_of_view.value) / 2)
    tall = half * camera.film[0] / camera.film[1]
    rays = ahead + np.array([[-half], [half], [half], [-half]]) * across
    rays += np.array([[tall], [tall], [-tall], [-tall]]) * up
    if rays[:, 1].min() <= 1e-3 * np.linalg.norm(rays, axis=1).max():
        raise ConfigurationError(
            "camera: a corner of its picture shows what is beyond the wall's horizon; turn it more "
            "towards the wall, or make its field of view smaller"
        )
    reach = (distance - position[1]) / rays[:, 1:2]
    return np.asarray((position + reach * rays)[:, [0, 2]])


WALL = {"least": 1.0, "beyond": 1.5}
"""Metres that the wall reaches at least to each side of the middle of the camera's view; its size
over that of the view: numbers may change."""

CYLINDER = "cylinder"
"""Name of the mesh that cylinders share."""


def scene_text(laboratory: Laboratory, meshes: Mapping[str, str], title: str) -> str:
    """Return the XML of a laboratory; its comment begins with a title.

    `meshes` maps the name of each occluder that is a mesh, and `CYLINDER`, to its file beside the
    scene. Numbers without an error are a `ConfigurationError`.
    """
    scene, camera = SceneText(laboratory), laboratory.camera
    _add_wall(scene, laboratory, corners_seen(camera, laboratory.wall.distance.value))
    if isinstance(camera, RectifiedCamera):
        _add_rectified(scene, camera)
    else:
        _add_camera(scene, camera)
    _add_monitor(scene, laboratory)
    to_world: dict[str, list[str]] = {"": []}  # from each occluder's own coordinates
    for body in laboratory.occluders:
        add = _add_rod if isinstance(body, Rod) else _add_body
        to_world[body.name] = add(scene, body, to_world[body.bearer], meshes)  # type: ignore[arg-type]
    return scene.text(title)


def _add_wall(scene: SceneText, laboratory: Laboratory, view: Array) -> None:
    """Add a wall that reaches beyond the camera's view of it."""
    low, high = view.min(axis=0), view.max(axis=0)
    x, z = map(float, np.round((low + high) / 2, 2))
    half = max(WALL["least"], float(np.ceil(50 * WALL["beyond"] * np.max(high - low)) / 100))
    scene.section("The wall: its y.")
    y = scene.declare("wall_distance", laboratory.wall.distance, "length", "wall.distance")
    place = tag("scale", value=half), tag("rotate", x=1, angle=90), tag("translate", x=x, y=y, z=z)
    scene.add("rectangle", "wall", transform(*place), paint(laboratory.wall.reflectance))


def _add_camera(scene: SceneText, camera: PerspectiveCamera) -> None:
    scene.section("The camera: its place, the wall's point that it looks at, how wide it sees.")
    scene.place("camera", camera.position, "camera.position")
    rolled = scene.declare("camera_roll", camera.roll, "angle", "camera.roll")
    scene.place("target", camera.target, "camera.target", "xz")
    eye, point = "$camera_x, $camera_y, $camera_z", "$target_x, $wall_distance, $target_z"
    fov = scene.declare("field_of_view", camera.field_of_view, "angle", "camera.field_of_view")
    to_world = transform(
        tag("rotate", z=1, angle=rolled), tag("lookat", origin=eye, target=point, up="0, 0, 1")
    )
    lens = tag("float", name="fov", value=fov), tag("string", name="fov_axis", value="x")
    scene.add_camera("perspective", camera.film, *lens, to_world)


def _add_rectified(scene: SceneText, camera: RectifiedCamera) -> None:
    """See an upright rectangle squarely; the camera's own x runs to the left."""
    scene.section("What the rectified picture shows of the wall, from its lower left corner.")
    place = scene.place("view", camera.bottom_left, "camera.bottom_left", "xz")
    width = scene.declare("view_width", camera.width, "length", "camera.width")
    height = scene.declare("view_height", camera.height, "length", "camera.height")
    to_world = transform(
        tag("scale", y=camera.film[1] / camera.film[0]),
        tag("translate", x=-1, y=1),
        tag("scale", x=0.5, y=0.5),
        tag("scale", x=width, y=height),
        tag("lookat", origin="0, -0.05, 0", target="0, 0, 0", up="0, 0, 1"),
        place,
        tag("translate", y="$wall_distance"),
    )
    near = tag("float", name="near_clip", value=0.001)
    scene.add_camera("orthographic", camera.film, to_world, near)


def _add_monitor(scene: SceneText, laboratory: Laboratory) -> None:
    monitor = laboratory.monitor
    where, place = next((name, place) for name, place in monitor.places.items() if place)
    scene.section(
        f"The lit part of the monitor: its size, the place of its {where.replace('_', ' ')} as a "
        "viewer sees it, how it is tilted and turned there; at 0 it faces the wall squarely."
    )
    width = scene.declare("monitor_width", monitor.width, "length", "monitor.width")
    height = scene.declare("monitor_height", monitor.height, "length", "monitor.height")
    to_place = scene.place(MONITOR, place, f"monitor.{where}")
    turns = scene.turns(MONITOR, monitor.tilt, monitor.turn, MONITOR)
    across = {"left": 1, "right": -1}.get(where.partition("_")[2], 0)
    up = {"top": -1, "bottom": 1}.get(where.partition("_")[0], 0)
    kind, emitter = "area", [tag("rgb", name="radiance", value=1)]
    if monitor.falloff is not None:
        kind = "lcd"
        scene.section(
            "Its falloff with angle: radiance over the normal's is cos^vertical_exponent of the "
            "vertical angle times cos^horizontal_exponent of the horizontal one."
        )
        for name in ("vertical", "horizontal"):
            measured, key = getattr(monitor.falloff, name), f"{name}_exponent"
            exponent = scene.declare(key, measured, "number", f"monitor.{name}")
            emitter.append(tag("float", name=key, value=exponent))
    to_world = transform(
        tag("translate", x=across, y=up),
        tag("scale", x=0.5, y=0.5),
        tag("scale", x=width, y=height),
        tag("rotate", x=1, angle=90),  # Mitsuba's rectangle: its u to a viewer's right, its v up
        tag("rotate", z=1, angle=180),
        *turns,
        to_place,
    )
    inside = "\n    ".join(emitter)
    lit = f'<emitter type="{kind}">\n    {inside}\n</emitter>'
    scene.add("rectangle", MONITOR, to_world, lit, paint((0.05, 0.05, 0.05)))


def _placed(body: Occluding, measured: Measured) -> Measured:
    """Return a place or turn; one without an error is exact if another occluder bears this one."""
    return exactly(measured.value) if body.bearer and measured.error is None else measured


def _beside(body: Occluding) -> str:
    return f", in the coordinates of '{body.bearer}'" if body.bearer else ""


def _add_rod(scene: SceneText, body: Rod, bearer: list[str], _: Mapping[str, str]) -> list[str]:
    """Add a rod, given its bearer's tags to the world; return these."""
    name, entry = body.name, f"occluder '{body.name}'"
    scene.section(f"The rod '{name}': its ends{_beside(body)}, and its radius.")
    for end, point in (("start", body.start), ("end", body.end)):
        measured = [_placed(body, each) for each in point]
        scene.place(f"{name}_{end}", measured, f"{entry}: {end}")
    value, error = body.diameter.value, body.diameter.error
    radius = Measured(value / 2, None if error is None else error / 2)
    declared = scene.declare(f"{name}_radius", radius, "length", f"{entry}: diameter")
    ends = [
        tag("point", name=p, value=f"${name}_{end}_x, ${name}_{end}_y, ${name}_{end}_z")
        for p, end in (("p0", "start"), ("p1", "end"))
    ]
    thickness = tag("float", name="radius", value=declared)
    to_world = transform(*bearer) if bearer else ""
    scene.add("cylinder", name, *ends, thickness, to_world, paint(body.reflectance))
    return bearer


def _add_body(
    scene: SceneText,
    body: Box | Frame | UprightCylinder | MeshBody,
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
        flat = tag("boolean", name="face_normals", value="true")
        scene.add("ply", name, file, flat, transform(*shaping, *to_world), paint(body.reflectance))

    def add_cube(label: str, *shaping: str) -> None:
        scene.add("cube", label, transform(*shaping, *to_world), paint(body.reflectance))

    if isinstance(body, MeshBody):
        add_mesh(name)
    elif isinstance(body, UprightCylinder):
        shaping = [tag("translate", z=-0.5)] if anchor == "center" else []
        across = size("diameter")
        add_mesh(CYLINDER, *shaping, tag("scale", x=across, y=across, z=size("height")))
    elif isinstance(body, Frame):
        sizes = [size(which) for which in ("width", "thickness", "height", "bar")]
        for side, bar in _bars(*sizes).items():
            add_cube(f"{name}_{side}", *bar)
    else:
        deep = "depth" if isinstance(body, Box) else "thickness"
        x, y, z = {"base": (0, 0, 1), "corner": (1, 1, 1), "center": (0, 0, 0)}[anchor]
        sizes = [size(which) for which in ("width", deep, "height")]
        scaled = tag("scale", **dict(zip("xyz", sizes, strict=True)))
        add_cube(name, tag("translate", x=x, y=y, z=z), tag("scale", value=0.5), scaled)
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
