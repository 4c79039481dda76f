"""What A would get wrong is refused by name; what looks like it and is not is rendered right.

The truth is Mitsuba's own, of the file as it stands: sampled by the BSDF alone, or of all bounces.
With emitter sampling and one bounce it would share the blind spots of A.
"""

import pytest

from experiments.setting import render_place
from periscopy_sim.errors import SceneError
from periscopy_sim.rendering.ambient.background import render_background
from periscopy_sim.rendering.transport.shadow_rays import render_transport

GLASS = '<bsdf type="dielectric"/>'
FOG = (
    '<medium type="homogeneous" name="{}"><float name="sigma_t" value="2"/>'
    '<float name="albedo" value="0.9"/></medium>'
)
PLACE = '<scale value="0.15"/><rotate x="1" angle="90"/><rotate z="1" angle="{}"/>'
FRONT, BACK = (PLACE.format(angle) + '<translate x="0.2" z="0.3"/>' for angle in (180, 0))
ROUND = '<scale value="0.1"/><translate x="0.2" z="0.3"/>'


def masked(opacity, inner='<bsdf type="diffuse"/>'):
    return f'<bsdf type="mask">{opacity}{inner}</bsdf>'


def number(name, value, tag="float"):
    return f'<{tag} name="{name}" value="{value}"/>'


def grouped(shape):
    """The shape, not in the scene itself but as an instance."""
    return (
        f'<shape type="shapegroup" id="group">{shape}</shape>'
        '<shape type="instance" id="copy"><ref id="group"/></shape>'
    )


def with_light(room, kind, inside="", to_world=FRONT):
    return (
        f'<shape type="{kind}" id="monitor">{inside}<transform name="to_world">{to_world}'
        f"</transform>{room.area}{room.black}</shape>"
    )


def refusal(room, *extra, **parts):
    with pytest.raises(SceneError) as caught:
        room.load(*extra, **parts)
    message = str(caught.value)
    assert "\n" not in message
    return message


# -- what lets light through ---------------------------------------------------------------------

SEE_THROUGH = {
    "mask of 0.9": masked(number("opacity", 0.9)),
    "pattern": masked('<texture type="checkerboard" name="opacity"/>'),
    "null": '<bsdf type="null"/>',
    "dielectric": GLASS,
    "principled": f'<bsdf type="principled">{number("spec_trans", 0.7)}</bsdf>',
    "blend": f'<bsdf type="blendbsdf">{number("weight", 0.5)}<bsdf type="diffuse"/>'
    '<bsdf type="thindielectric"/></bsdf>',
    "mask of glass": masked(number("opacity", 1), GLASS),
}
NAMES = {
    "mask of 0.9": "mask",
    "pattern": "mask",
    "blend": "thindielectric",
    "mask of glass": "dielectric",
}


@pytest.mark.parametrize("kind", SEE_THROUGH)
@pytest.mark.parametrize("group", [str, grouped], ids=["shape", "instance"])
def test_shape_that_lets_light_through_is_refused_with_its_bsdf(room, kind, group):
    message = refusal(room, group(room.blocker(bsdf=SEE_THROUGH[kind])))
    assert f"shape 'ball' may let light through (bsdf '{NAMES.get(kind, kind)}')" in message
    assert "remove the shape, or give it an opaque bsdf" in message


@pytest.mark.parametrize("part", ["wall", "monitor"])
def test_wall_and_monitor_may_not_let_light_through_either(room, part):
    thin = SEE_THROUGH["mask of 0.9"]
    shape = room.wall(thin) if part == "wall" else room.monitor(inside=thin)
    assert f"shape '{part}' may let light through (bsdf 'mask')" in refusal(room, **{part: shape})


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
@pytest.mark.usefixtures("jit")
def test_opaque_shape_casts_the_shadow_of_a_black_one(room, bsdf):
    shadow = render_transport(room.load(room.blocker()))
    assert render_transport(room.load(room.blocker(bsdf=bsdf))).tobytes() == shadow.tobytes()


@pytest.mark.usefixtures("jit")
@pytest.mark.parametrize("group", [str, grouped], ids=["shape", "instance"])
def test_shadow_of_a_shape_and_of_an_instance_is_right(room, is_right, group):
    is_right(group(room.blocker()))


# -- participating media -------------------------------------------------------------------------


def test_medium_within_a_shape_is_refused(room):
    fog = f'<shape type="cube" id="cloud">{FOG.format("interior")}<bsdf type="diffuse"/></shape>'
    assert "shape 'cloud' holds a participating medium (homogeneous)" in refusal(room, fog)


@pytest.mark.usefixtures("jit")
def test_medium_about_the_camera_is_refused_for_ambient_light_and_places_too(room):
    camera = room.camera().replace("<film", FOG.format("medium") + "<film")
    assert "sensor 'camera' holds a participating medium" in refusal(room, camera=camera)
    with pytest.raises(SceneError, match="sensor 'camera' holds a participating medium"):
        render_background(room.write(camera=camera), room.load())
    path = room.write(camera=camera.replace('id="camera"', 'id="wide"'))
    with pytest.raises(SceneError, match="sensor 'wide' holds a participating medium"):
        render_place(path, samples=1, size=(2, 2))


# -- the wall ------------------------------------------------------------------------------------


# -- the monitor's UV square ---------------------------------------------------------------------


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


WHOLE, LEFT, RIGHT = (0.4, 0.0), (0.4, 0.2), (0.2, 0.0)


@pytest.mark.parametrize(
    ("faces", "share"),
    [
        ([(LEFT, (0, 1, 0, 1)), (RIGHT, (0, 1, 0, 1))], "50.0%"),
        ([(WHOLE, (0, 2, 0, 1))], "50.0%"),
        ([(LEFT, (0, 0.6, 0, 1)), (RIGHT, (0.5, 1, 0, 1))], "9"),
    ],
    ids=["twice", "up to 2", "overlap"],
)
def test_monitor_with_light_outside_of_its_uv_square_is_refused(room, faces, share):
    message = refusal(room, monitor=screen(room, faces), hidden=(2, 2))
    assert f"the monitor's patches would hold {share}" in message
    assert "UV coordinates of its own, from 0 to 1" in message


@pytest.mark.parametrize("turn", [180, 0])
def test_box_is_refused_as_a_monitor(room, turn):
    box = with_light(room, "cube", to_world='<scale z="0.1"/>' + (FRONT if turn else BACK))
    assert "of a box, its front alone is the monitor" in refusal(room, monitor=box)


@pytest.mark.usefixtures("jit")
def test_light_of_a_screen_of_two_quads_is_right(room, is_right):
    two = screen(room, [(LEFT, (0, 0.5, 0, 1)), (RIGHT, (0.5, 1, 0, 1))])
    is_right(monitor=two)


@pytest.mark.thorough
@pytest.mark.usefixtures("jit")
@pytest.mark.parametrize(
    ("kind", "inside", "to_world"),
    [
        ("disk", "", FRONT),
        ("sphere", "", '<rotate x="1" angle="40"/>' + ROUND),
        ("cylinder", "", ROUND),
    ],
)
def test_light_of_a_curved_monitor_is_right(room, is_right, kind, inside, to_world):
    monitor = with_light(room, kind, inside, to_world)
    is_right(monitor=monitor, samples=64, pixel_samples=4)


def test_sphere_whose_points_mitsuba_misses_is_refused(room):
    monitor = with_light(room, "sphere", to_world=f'<rotate x="1" angle="90"/>{ROUND}')
    message = refusal(room, monitor=monitor, hidden=(2, 2))
    assert "Mitsuba finds no point of the monitor" in message


@pytest.mark.parametrize("kind", ["sphere", "cylinder"])
@pytest.mark.parametrize("flip", ["", '<boolean name="flip_normals" value="true"/>'])
def test_round_monitor_turned_inside_out_is_refused(room, kind, flip):
    to_world = ROUND if flip else '<scale x="-1"/>' + ROUND
    message = refusal(room, monitor=with_light(room, kind, flip, to_world))
    assert f"'monitor' is a {kind} turned inside out" in message
