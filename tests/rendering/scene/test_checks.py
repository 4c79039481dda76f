"""Scenes that have no A, or whose A would be wrong, are refused by the offender's name.

What looks like it and is not is rendered right.

The truth is Mitsuba's own, of the unchanged file: sampled by the BSDF alone, or of all bounces.
With emitter sampling and one bounce it would share the blind spots of A.
"""

import numpy as np
import pytest

from experiments.setting import render_place
from periscopy_sim.errors import SceneError
from periscopy_sim.numerics.validation import InputError
from periscopy_sim.rendering.ambient.background import render_background
from periscopy_sim.rendering.transport.shadow_rays import render_transport
from periscopy_sim.scenario import load_scenario

FOG = (
    '<medium type="homogeneous" name="{}"><float name="sigma_t" value="2"/>'
    '<float name="albedo" value="0.9"/></medium>'
)
PLACE = '<scale value="0.15"/><rotate x="1" angle="90"/><rotate z="1" angle="{}"/>'
FRONT = PLACE.format(180) + '<translate x="0.2" z="0.3"/>'


def masked(opacity, inner='<bsdf type="diffuse"/>'):
    return f'<bsdf type="mask">{opacity}{inner}</bsdf>'


def number(name, value, tag="float"):
    return f'<{tag} name="{name}" value="{value}"/>'


def grouped(shape, kind="shapegroup"):
    """The shape, not in the scene itself but within another, or as an instance."""
    copy = '<shape type="instance" id="copy"><ref id="group"/></shape>'
    group = f'<shape type="{kind}" id="group">{shape}</shape>'
    return group + (copy if kind == "shapegroup" else "")


def with_light(room, kind, inside="", to_world=FRONT):
    return (
        f'<shape type="{kind}" id="monitor">{inside}<transform name="to_world">{to_world}'
        f"</transform>{room.area}{room.black}</shape>"
    )


GLASS = '<bsdf type="dielectric"/>'
SCREEN_OBJ = "v 0.4 0 0.15\nv 0 0 0.15\nv 0 0 0.45\nv 0.4 0 0.45\nf 1 2 3\nf 1 3 4\n"
WHOLE, LEFT, RIGHT = (0.4, 0.0), (0.4, 0.2), (0.2, 0.0)
PATCHED = (  # some of it glossy, some of it not
    '<bsdf type="blendbsdf"><texture type="checkerboard" name="weight"><transform name="to_uv">'
    '<scale value="5"/></transform></texture><bsdf type="diffuse"/><bsdf type="roughconductor">'
    '<float name="alpha" value="0.3"/></bsdf></bsdf>'
)
VARNISHED = (
    '<bsdf type="roughplastic"><rgb name="diffuse_reflectance" value="0.8, 0.2, 0.1"/></bsdf>'
)
BLEND = f'<bsdf type="blendbsdf">{number("weight", 0.5)}<bsdf type="diffuse"/>{{}}</bsdf>'


def ball(room, bsdf):
    return {"extra": room.blocker(bsdf=bsdf)}


def named(room, part, reflectance):
    bsdf = f'<bsdf type="diffuse"><rgb name="reflectance" value="{reflectance}"/></bsdf>'
    return {part: getattr(room, part)(bsdf)}


REFUSED = {
    "no wall": ("'wall'", lambda _: {"wall": ""}),
    "no monitor": ("'monitor'", lambda _: {"monitor": ""}),
    "no camera": ("'camera'", lambda _: {"camera": ""}),
    "wall within a merge": ("'wall'", lambda r: {"wall": grouped(r.wall(), "merge")}),
    "wall within a group": ("'wall'", lambda r: {"wall": grouped(r.wall())}),
    "unknown plugin": ('"blob"', lambda _: {"extra": '<shape type="blob" id="ball"/>'}),
    "unknown property": ("radiuss", lambda _: {"extra": SPHERE.format(number("radiuss", 1))}),
    "missing mesh": ("sofa.ply", lambda _: {"extra": mesh("meshes/sofa.ply")}),
    "thin lens": ("in focus", lambda r: {"camera": r.camera().replace(*LENS)}),
    "unknown film": ("hdrfilm", lambda r: {"camera": r.camera(film="specfilm")}),
    "film without pixels": ("5x0", lambda r: {"camera": r.camera((5, 0))}),
    "film of 25 million": ("5000x5000", lambda r: {"camera": r.camera((5000, 5000))}),
    "film of too long a row": ("4194305", lambda r: {"camera": r.camera((1, 2**22 + 1))}),
    "more patches than pixels": ("1x31", lambda _: {"hidden": (1, 31)}),
    "no patches": ("(0, 4)", lambda _: {"hidden": (0, 4)}),
    "pixels off the wall": ("10 of 30", lambda r: {"wall": r.wall(x=-0.25)}),
    "uneven wall": ("blendbsdf", lambda r: {"wall": r.wall(PATCHED)}),
    "varnished wall": ("roughplastic", lambda r: {"wall": r.wall(VARNISHED)}),
    "mirror as wall": ("conductor", lambda r: {"wall": r.wall('<bsdf type="conductor"/>')}),
    "wall from behind": ("reflects nothing", lambda r: {"wall": r.wall(angle=-90)}),
    "wall nowhere": ("'wall'", lambda r: {"wall": r.wall(x="1e39")}),
    "wall of nan": ("scene", lambda r: named(r, "wall", "nan")),
    "wall of glass": ("'wall'", lambda r: {"wall": r.wall(masked(number("opacity", 0.9)))}),
    "monitor of gauze": (
        "'monitor'",
        lambda r: {"monitor": r.monitor(inside=masked(number("opacity", 0.9)))},
    ),
    "no radiance": ("radiance", lambda r: {"monitor": r.monitor('<emitter type="area"/>')}),
    "monitor of no width": ("'monitor'", lambda r: {"monitor": r.monitor(scale=(0, 0.15))}),
    "monitor of no height": ("'monitor'", lambda r: {"monitor": r.monitor(scale=(0.2, 0))}),
    "monitor nowhere": ("'monitor'", lambda r: {"monitor": r.monitor(scale=("nan", 0.15))}),
    "monitor turned away": ("faces away", lambda r: {"monitor": r.monitor(turn=0)}),
    "monitor flipped": ("faces away", lambda r: {"monitor": r.monitor(flip=True)}),
    "exponent of nan": ("exponents", lambda r: {"monitor": r.monitor(r.lcd(np.nan, 1))}),
    "exponent below 0": ("exponents", lambda r: {"monitor": r.monitor(r.lcd(1, -0.5))}),
    "monitor without UV": ("UV", lambda r: {"monitor": obj_monitor(r)}),
    "UV twice": ("200.0%", lambda r: two_quads(r, (LEFT, (0, 1, 0, 1)), (RIGHT, (0, 1, 0, 1)))),
    "UV up to 2": ("200.0%", lambda r: two_quads(r, (WHOLE, (0, 2, 0, 1)))),
    "UV overlap": (
        "110.0%",
        lambda r: two_quads(r, (LEFT, (0, 0.6, 0, 1)), (RIGHT, (0.5, 1, 0, 1))),
    ),
    "box as monitor": ("box", lambda r: shining(r, "cube", "", '<scale z="0.1"/>' + FRONT)),
    "gauze": ("'ball'", lambda r: ball(r, masked(number("opacity", 0.9)))),
    "pattern": ("mask", lambda r: ball(r, masked('<texture type="checkerboard" name="opacity"/>'))),
    "null": ("null", lambda r: ball(r, '<bsdf type="null"/>')),
    "glass": ("dielectric", lambda r: ball(r, GLASS)),
    "glass in a group": ("dielectric", lambda r: {"extra": grouped(r.blocker(bsdf=GLASS))}),
    "glass in a mask": ("dielectric", lambda r: ball(r, masked(number("opacity", 1), GLASS))),
    "glass in a blend": ("dielectric", lambda r: ball(r, BLEND.format(GLASS))),
    "clear principled": (
        "principled",
        lambda r: ball(r, f'<bsdf type="principled">{number("spec_trans", 0.7)}</bsdf>'),
    ),
    "box inside out": ("'box'", lambda r: {"extra": r.cube((0.4, 0.5, 0.3), (-0.1, 0.1, 0.1))}),
    "box of no width": ("'box'", lambda r: {"extra": r.cube((0.4, 0.5, 0.3), (0, 0.1, 0.1))}),
    "box of a trace": ("'box'", lambda r: {"extra": r.cube((0.4, 0.5, 0.3), (1e-308, 0.1, 0.1))}),
    "ball of no radius": ("'ball'", lambda r: {"extra": r.blocker(radius=0)}),
    "fog": ("'cloud'", lambda _: {"extra": FOGGY}),
}
LENS = (
    'orthographic" id="camera"><transform name="to_world"><scale x="0.2" y="0.2"/>',
    f'thinlens" id="camera">{number("aperture_radius", 0.05)}<transform name="to_world">',
)
SPHERE = '<shape type="sphere" id="ball">{}</shape>'
FOGGY = f'<shape type="cube" id="cloud">{FOG.format("interior")}<bsdf type="diffuse"/></shape>'


def mesh(filename):
    return f'<shape type="ply" id="sofa"><string name="filename" value="{filename}"/></shape>'


def obj_monitor(room):
    (room.folder / "screen.obj").write_text(SCREEN_OBJ)
    return (
        '<shape type="obj" id="monitor"><string name="filename" value="screen.obj"/>'
        f"{room.lcd()}{room.black}</shape>"
    )


def two_quads(room, *faces):
    return {"monitor": screen(room, faces)}


def shining(room, *how):
    return {"monitor": with_light(room, *how)}


@pytest.mark.parametrize("kind", REFUSED)
def test_scene_is_refused_by_the_offenders_name(room, kind):
    name, parts_of = REFUSED[kind]
    parts = parts_of(room)
    with pytest.raises((SceneError, InputError)) as caught:
        room.load(parts.pop("extra", ""), **parts)
    assert name in str(caught.value) and "\n" not in str(caught.value)


PARAMETER = '<default name="radius" value="{}"/>'


@pytest.mark.parametrize("value", ["nan", "-inf", "1e999", "0.1, NaN, 0"])
def test_parameters_that_are_not_finite_are_refused_by_name(room, value):
    shape = room.blocker(radius="$radius")
    for declared, given in (("0.1", {"radius": value}), (value, {})):
        path = room.write(PARAMETER.format(declared), shape)
        with pytest.raises(SceneError, match="'radius'"):
            load_scenario(path, (2, 3), given)
    with pytest.raises(SceneError, match=r"'color'.*radius"):
        load_scenario(room.write(PARAMETER.format("0.1"), shape), (2, 3), {"color": 1})


def test_files_that_are_missing_or_include_themselves_are_refused(room, tmp_path):
    (tmp_path / "a.xml").write_text('<scene version="3.0.0"><include filename="a.xml"/></scene>')
    for path in (tmp_path / "none.xml", tmp_path, room.write('<include filename="a.xml"/>')):
        with pytest.raises(SceneError):
            load_scenario(path, (2, 3))


@pytest.mark.parametrize(
    "bsdf",
    [
        masked(number("opacity", 1)),
        '<bsdf type="twosided"><bsdf type="plastic"/></bsdf>',
        f'<bsdf type="principled">{number("spec_trans", 0)}</bsdf>',
        '<bsdf type="conductor"/>',
        "",
    ],
)
def test_opaque_shape_casts_the_shadow_of_a_black_one(room, bsdf):
    shadow = render_transport(room.load(room.blocker()))
    assert render_transport(room.load(room.blocker(bsdf=bsdf))).tobytes() == shadow.tobytes()


@pytest.mark.parametrize("group", [str, grouped], ids=["shape", "instance"])
def test_shadow_of_a_shape_and_of_an_instance_is_right(room, is_right, group):
    is_right(group(room.blocker()))


def test_medium_about_the_camera_is_refused_for_ambient_light_and_places_too(room):
    plain, camera = room.load(), room.camera().replace("<film", FOG.format("medium") + "<film")
    for render in (room.load, lambda camera: render_background(room.write(camera=camera), plain)):
        with pytest.raises(SceneError, match="sensor 'camera' holds a participating medium"):
            render(camera=camera)
    path = room.write(camera=camera.replace('id="camera"', 'id="wide"'))
    with pytest.raises(SceneError, match="sensor 'wide' holds a participating medium"):
        render_place(path, samples=1, size=(2, 2))


def screen(room, faces, name="screen"):
    """A monitor of quads: (x0, x1) of each, and the (u0, u1, v0, v1) of its corners."""
    vertices, triangles = [], []
    for (left, right), (u0, u1, v0, v1) in faces:
        first = len(vertices)
        vertices += [
            (left, 0, 0.15, u0, v0), (right, 0, 0.15, u1, v0),
            (right, 0, 0.45, u1, v1), (left, 0, 0.45, u0, v1),
        ]  # fmt: skip
        triangles += [(first, first + 1, first + 2), (first, first + 2, first + 3)]
    (room.folder / f"{name}.ply").write_text(
        f"ply\nformat ascii 1.0\nelement vertex {len(vertices)}\n"
        + "".join(f"property float {key}\n" for key in "xyzuv")
        + f"element face {len(triangles)}\nproperty list uchar int vertex_indices\nend_header\n"
        + "\n".join(" ".join(map(str, row)) for row in vertices)
        + "\n"
        + "\n".join("3 " + " ".join(map(str, row)) for row in triangles)
        + "\n"
    )
    return (
        f'<shape type="ply" id="monitor"><string name="filename" value="{name}.ply"/>'
        f"{room.area}{room.black}</shape>"
    )


def test_light_of_a_screen_of_two_quads_is_right(room, is_right):
    two = screen(room, [(LEFT, (0, 0.5, 0, 1)), (RIGHT, (0.5, 1, 0, 1))])
    is_right(monitor=two)


def test_a_cylinder_shows_no_image(room):
    """Mitsuba's own misplaces some points; its reason is told, and the remedy."""
    monitor = (
        '<shape type="cylinder" id="monitor"><point name="p0" x="0.2" y="0" z="0.2"/>'
        f'<point name="p1" x="0.2" y="0" z="0.4"/><float name="radius" value="0.1"/>{room.area}'
        "</shape>"
    )
    with pytest.raises(SceneError, match=r"is a cylinder.*use a mesh of it"):
        room.load(monitor=monitor)
