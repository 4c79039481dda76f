"""The wall, the camera, the monitor and the occluders of a measured laboratory, as a scene's text.

Mitsuba's XML has no arithmetic, but transforms: half of a width is a scaling by one half, and minus
half of it a scaling by -2, a shift by the width, and a scaling by -1/2.
"""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from xml.sax.saxutils import quoteattr

import numpy as np

from periscopy_sim.errors import ConfigurationError
from periscopy_sim.laboratory.corners import Aim, aim_at_corners, corners_seen
from periscopy_sim.laboratory.document import (
    Box,
    CornersCamera,
    Frame,
    Laboratory,
    MeshBody,
    Occluding,
    PerspectiveCamera,
    RectifiedCamera,
    Rod,
    UprightCylinder,
)
from periscopy_sim.laboratory.quantities import Measured
from periscopy_sim.laboratory.scene_text import SceneText, axes, paint, transform
from periscopy_sim.scenario import Array

LEAST_WALL = 1.0
"""Metres that the wall reaches, at least, to each side of the middle of what the camera sees."""

BEYOND = 1.5
"""Times what the camera sees of the wall that it reaches: numbers may change."""

CYLINDER = "cylinder"
"""Name of the mesh that cylinders share."""

FACE_THE_WALL = '<rotate x="1" angle="90"/>', '<rotate z="1" angle="180"/>'
"""From Mitsuba's rectangle, x to y, to one whose u runs to a viewer's right and whose v runs up."""


def scene_text(laboratory: Laboratory, meshes: Mapping[str, str], title: str) -> str:
    """Return the XML of a laboratory; its comment begins with a title.

    `meshes` maps the name of each occluder that is a mesh, and `CYLINDER`, to its file beside the
    scene. A number without an error, or corners that no camera sees, is a `ConfigurationError`.
    """
    scene, camera = SceneText(laboratory), laboratory.camera
    aim = aim_of(laboratory)
    _require_before_wall(laboratory)
    _add_wall(scene, laboratory, _seen(laboratory, aim))
    if isinstance(camera, RectifiedCamera):
        _add_rectified(scene, camera)
    else:
        _add_camera(scene, camera, aim)
    _add_monitor(scene, laboratory)
    to_world: dict[str, list[str]] = {"": []}  # from each occluder's own coordinates
    for body in laboratory.occluders:
        to_world[body.name] = _add_occluder(scene, body, meshes, to_world[body.bearer])
    return scene.text(title)


def _require_before_wall(laboratory: Laboratory) -> None:
    """Refuse a monitor or an occluder behind the wall."""
    given = laboratory.monitor.places
    places = {f"monitor.{name}": place for name, place in given.items() if place}
    for body in laboratory.occluders:
        if isinstance(body, Rod):
            own = {"start": body.start, "end": body.end}
        else:
            own = {"position": body.position}
        # Those of others are in their bearer's coordinates, or in a mesh file's.
        if not body.bearer and getattr(body, "anchor", "") != "origin":
            places |= {f"occluder '{body.name}': {name}": place for name, place in own.items()}
    for entry, place in places.items():
        if place[1].value >= laboratory.wall.distance.value:
            raise ConfigurationError(f"{entry}: it lies behind the wall; its y is too large")


def aim_of(laboratory: Laboratory) -> Aim | None:
    """Return what the corners say of the camera; None of a camera that has no corners."""
    camera, distance = laboratory.camera, laboratory.wall.distance.value
    if not isinstance(camera, RectifiedCamera) and camera.position[1].value >= distance:
        raise ConfigurationError("camera.position: it lies behind the wall; its y is too large")
    if not isinstance(camera, CornersCamera):
        return None
    general = 0.0 if laboratory.errors.length is None else laboratory.errors.length.value

    def errors(points: Iterable[Iterable[Measured]]) -> list[list[float]]:
        return [[general if c.error is None else c.error for c in point] for point in points]

    named = camera.corners
    corners = (named.top_left, named.top_right, named.bottom_right, named.bottom_left)
    position = np.array([each.value for each in camera.position])
    return aim_at_corners(
        position,
        distance,
        np.array([[each.value for each in corner] for corner in corners]),
        camera.film,
        np.array(errors([camera.position])[0]),
        np.array(errors(corners)),
    )


def _seen(laboratory: Laboratory, aim: Aim | None) -> Array:
    """Return x and z of the wall's points in the corners of the picture, (4, 2)."""
    camera, distance = laboratory.camera, laboratory.wall.distance.value
    if isinstance(camera, RectifiedCamera):
        x, z = (each.value for each in camera.bottom_left)
        width, height = camera.width.value, camera.height.value
        return np.array([(x, z + height), (x + width, z + height), (x + width, z), (x, z)])
    position = np.array([each.value for each in camera.position])
    if aim is not None:
        return corners_seen(position, distance, camera.film, *aim.values.values())
    assert isinstance(camera, PerspectiveCamera)
    if camera.target is not None:
        x, z = (each.value for each in camera.target)
    else:
        turn, tilt = (
            np.radians(0.0 if angle is None else angle.value)
            for angle in (camera.turn, camera.tilt)
        )
        ahead = np.array([-np.sin(turn) * np.cos(tilt), np.cos(turn) * np.cos(tilt), np.sin(tilt)])
        if ahead[1] < 1e-3:
            raise ConfigurationError("camera.turn: it looks away from the wall; 0 looks at it")
        x, _, z = position + (distance - position[1]) / ahead[1] * ahead
    if camera.field_of_view is not None:
        width = camera.field_of_view.value
    else:
        assert camera.vertical_field_of_view is not None
        half = np.tan(np.radians(camera.vertical_field_of_view.value / 2))
        width = 2 * np.degrees(np.arctan(half * camera.film[1] / camera.film[0]))
    return corners_seen(position, distance, camera.film, x, z, camera.roll.value, width)


def _add_wall(scene: SceneText, laboratory: Laboratory, seen: Array) -> None:
    """Add a wall that reaches beyond what the camera sees of it."""
    wall = laboratory.wall
    low, high = seen.min(axis=0), seen.max(axis=0)
    x, z = map(float, np.round((low + high) / 2, 2))
    half = max(LEAST_WALL, float(np.ceil(100 * BEYOND * np.max(high - low) / 2) / 100))
    scene.section("The wall: its y.")
    distance = scene.declare("wall_distance", wall.distance, "length", "wall.distance")
    scene.add(
        [
            '<shape type="rectangle" id="wall">',
            *transform(
                f'<scale value="{half!r}"/>',
                '<rotate x="1" angle="90"/>',
                f'<translate x="{x!r}" y="{distance}" z="{z!r}"/>',
            ),
            *paint(wall.reflectance),
            "</shape>",
        ]
    )


def _add_camera(
    scene: SceneText, camera: PerspectiveCamera | CornersCamera, aim: Aim | None
) -> None:
    scene.section("The camera: its place, where it looks, how wide.")
    place = scene.place("camera", camera.position, "camera.position")
    target: Iterable[Measured] | None
    field, side = "field_of_view", "x"
    if aim is not None:
        found = {name: Measured(value, aim.errors[name]) for name, value in aim.values.items()}
        scene.section(
            "Found from the four corners on the wall, which this leaves by "
            f"{1000 * aim.residual:.2g} mm (rms): the wall's point in the picture's middle, how "
            "far the camera is rolled clockwise, and the angle of the picture's width."
        )
        target = (found["target_x"], found["target_z"])
        roll, seen = found["camera_roll"], found["field_of_view"]
    else:
        assert isinstance(camera, PerspectiveCamera)
        target, roll = camera.target, camera.roll
        if camera.field_of_view is None:
            field, side = "vertical_field_of_view", "y"
        seen = getattr(camera, field)
    rolled = scene.declare("camera_roll", roll, "angle", "camera.roll")
    turned = [f'<rotate z="1" angle="{rolled}"/>']
    if target is not None:
        scene.place("target", target, "camera.target", "xz")
        points = (
            'origin="$camera_x, $camera_y, $camera_z" target="$target_x, $wall_distance, $target_z"'
        )
        turned.append(f'<lookat {points} up="0, 0, 1"/>')
    else:
        turned.append('<lookat origin="0, 0, 0" target="0, 1, 0" up="0, 0, 1"/>')
        for name, axis in (("tilt", "x"), ("turn", "z")):
            angle = getattr(camera, name) or Measured(0.0, 0.0)
            declared = scene.declare(f"camera_{name}", angle, "angle", f"camera.{name}")
            turned.append(f'<rotate {axis}="1" angle="{declared}"/>')
        turned.append(place)
    angle = scene.declare(field, seen, "angle", f"camera.{field}")
    scene.add(
        [
            '<sensor type="perspective" id="camera">',
            f'    <float name="fov" value="{angle}"/>',
            f'    <string name="fov_axis" value="{side}"/>',
            *transform(*turned),
            *scene.film(camera.film),
            "</sensor>",
        ]
    )


def _add_rectified(scene: SceneText, camera: RectifiedCamera) -> None:
    """See an upright rectangle squarely; the camera's own x runs to the left."""
    scene.section("What the rectified picture shows of the wall, from its lower left corner.")
    place = scene.place("view", camera.bottom_left, "camera.bottom_left", "xz")
    width = scene.declare("view_width", camera.width, "length", "camera.width")
    height = scene.declare("view_height", camera.height, "length", "camera.height")
    rows, columns = camera.film
    scene.add(
        [
            '<sensor type="orthographic" id="camera">',
            *transform(
                f'<scale y="{columns / rows!r}"/>',
                '<translate x="-1" y="1"/>',
                '<scale x="0.5" y="0.5"/>',
                f'<scale x="{width}" y="{height}"/>',
                '<lookat origin="0, -0.05, 0" target="0, 0, 0" up="0, 0, 1"/>',
                place,
                '<translate y="$wall_distance"/>',
            ),
            '    <float name="near_clip" value="0.001"/>',
            *scene.film(camera.film),
            "</sensor>",
        ]
    )


def _add_monitor(scene: SceneText, laboratory: Laboratory) -> None:
    monitor = laboratory.monitor
    where, place = next((name, place) for name, place in monitor.places.items() if place)
    scene.section(
        f"The lit part of the monitor: its size, the place of its {where.replace('_', ' ')} as a "
        "viewer sees it, how it is tilted and turned there; at 0 it faces the wall squarely."
    )
    width = scene.declare("monitor_width", monitor.width, "length", "monitor.width")
    height = scene.declare("monitor_height", monitor.height, "length", "monitor.height")
    to_place = scene.place("monitor", place, f"monitor.{where}")
    turns = scene.turns("monitor", monitor.tilt, monitor.turn, "monitor")
    across = {"left": 1, "right": -1}.get(where.partition("_")[2], 0)
    up = {"top": -1, "bottom": 1}.get(where.partition("_")[0], 0)
    emitter = ['    <emitter type="area">', '        <rgb name="radiance" value="1"/>']
    if monitor.falloff is not None:
        scene.section(
            "Its falloff with angle: radiance over the normal's is cos^vertical_exponent of the "
            "vertical angle times cos^horizontal_exponent of the horizontal one."
        )
        emitter[0] = '    <emitter type="lcd">'
        for name in ("vertical", "horizontal"):
            exponent = scene.declare(
                f"{name}_exponent", getattr(monitor.falloff, name), "number", f"monitor.{name}"
            )
            emitter.append(f'        <float name="{name}_exponent" value="{exponent}"/>')
    scene.add(
        [
            '<shape type="rectangle" id="monitor">',
            *transform(
                f'<translate x="{across}" y="{up}"/>',
                '<scale x="0.5" y="0.5"/>',
                f'<scale x="{width}" y="{height}"/>',
                *FACE_THE_WALL,
                *turns,
                to_place,
            ),
            *emitter,
            "    </emitter>",
            *paint((0.05, 0.05, 0.05)),
            "</shape>",
        ]
    )


def _add_occluder(
    scene: SceneText, body: Occluding, meshes: Mapping[str, str], bearer: list[str]
) -> list[str]:
    """Add an occluder, given its bearer's tags to the world; return its own tags to the world."""
    name, entry = body.name, f"occluder '{body.name}'"
    beside = f", in the coordinates of '{body.bearer}'" if body.bearer else ""

    def stated(measured: Measured) -> Measured:
        exact = bool(body.bearer) and measured.error is None
        return Measured(measured.value, 0.0) if exact else measured

    if isinstance(body, Rod):
        scene.section(f"The rod '{name}': its ends{beside}, and its radius.")
        for end, point in (("start", body.start), ("end", body.end)):
            scene.place(f"{name}_{end}", map(stated, point), f"{entry}: {end}")
        radius, given = body.radius, "radius"
        if body.diameter is not None:
            value, error = body.diameter.value, body.diameter.error
            radius, given = Measured(value / 2, None if error is None else error / 2), "diameter"
        assert radius is not None
        scene.declare(f"{name}_radius", radius, "length", f"{entry}: {given}")
        ends = [
            f'    <point name="{p}" value="${name}_{end}_x, ${name}_{end}_y, ${name}_{end}_z"/>'
            for p, end in (("p0", "start"), ("p1", "end"))
        ]
        scene.add(
            [
                f'<shape type="cylinder" id="{name}">',
                *ends,
                f'    <float name="radius" value="${name}_radius"/>',
                *(transform(*bearer) if bearer else []),
                *paint(body.reflectance),
                "</shape>",
            ]
        )
        return bearer
    anchor = getattr(body, "anchor", "base")
    scene.section(
        f"The {body.kind} '{name}': the place of its {anchor}, its tilt and turn there{beside}."
    )
    place = scene.place(name, map(stated, body.position), f"{entry}: position")
    turns = scene.turns(name, stated(body.tilt), stated(body.turn), entry)
    to_world = [*turns, place, *bearer]

    def length(size: str) -> str:
        return scene.declare(f"{name}_{size}", getattr(body, size), "length", f"{entry}: {size}")

    def add(kind: str, label: str, *shaping: str, file: str = "") -> None:
        scene.add(
            [
                f'<shape type="{kind}" id="{label}">',
                *([f'    <string name="filename" value={quoteattr(file)}/>'] if file else []),
                *(['    <boolean name="face_normals" value="true"/>'] if file else []),
                *transform(*shaping, *to_world),
                *paint(body.reflectance),
                "</shape>",
            ]
        )

    if isinstance(body, MeshBody):
        add("ply", name, file=meshes[name])
    elif isinstance(body, UprightCylinder):
        moved = ['<translate z="-0.5"/>'] if anchor == "center" else []
        if body.diameter is None:
            moved.append('<scale x="2" y="2"/>')
        across = length("radius" if body.diameter is None else "diameter")
        up = length("height")
        scaled = f'<scale x="{across}" y="{across}" z="{up}"/>'
        add("ply", name, *moved, scaled, file=meshes[CYLINDER])
    elif isinstance(body, Frame):
        sizes = [length(size) for size in ("width", "thickness", "height", "bar")]
        for side, shaping in _bars(*sizes).items():
            add("cube", f"{name}_{side}", *shaping)
    else:
        sizes = [
            length("width"),
            length("depth" if isinstance(body, Box) else "thickness"),
            length("height"),
        ]
        shift = {"base": (0, 0, 1), "corner": (1, 1, 1), "center": (0, 0, 0)}[anchor]
        add(
            "cube",
            name,
            f"<translate {axes(*map(str, shift))}/>",
            '<scale value="0.5"/>',
            f"<scale {axes(*sizes)}/>",
        )
    return to_world


def _bars(width: str, thickness: str, height: str, bar: str) -> dict[str, tuple[str, ...]]:
    """Return how Mitsuba's cube, of side 2, becomes each bar of a frame that stands on z = 0."""
    shrink = '<scale value="0.5"/>'
    upright = shrink, f"<scale {axes(bar, thickness, height)}/>"
    lying = shrink, f"<scale {axes(width, thickness, bar)}/>"
    return {
        "left": (
            '<translate x="1" z="1"/>', *upright,
            '<scale x="-2"/>', f'<translate x="{width}"/>', '<scale x="-0.5"/>',
        ),
        "right": (
            '<translate x="-1" z="1"/>', *upright,
            '<scale x="2"/>', f'<translate x="{width}"/>', '<scale x="0.5"/>',
        ),
        "bottom": ('<translate z="1"/>', *lying),
        "top": ('<translate z="-1"/>', *lying, f'<translate z="{height}"/>'),
    }  # fmt: skip
