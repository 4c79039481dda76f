"""Lamps without a size among clear shapes and mirrors: rejected, since paths miss their light."""

import numpy as np
import pytest

from periscopy_sim.errors import SceneError
from periscopy_sim.rendering.ambient.background import render_background
from periscopy_sim.rendering.ambient.emitter_backgrounds import emitter_backgrounds
from periscopy_sim.rendering.scene.refusals import SIZELESS

pytestmark = pytest.mark.usefixtures("jit")

LAMP = (
    '<emitter type="point" id="bulb"><point name="position" value="0.2, -0.5, 0.9"/>'
    '<rgb name="intensity" value="1"/></emitter>'
)


def masked(opacity, inner):
    return f'<bsdf type="mask"><float name="opacity" value="{opacity}"/>{inner}</bsdf>'


DIFFUSE = '<bsdf type="diffuse"/>'
BLACK = '<bsdf type="diffuse"><rgb name="reflectance" value="0"/></bsdf>'
CLEAR = {
    "mask": masked(0.3, BLACK),
    "thindielectric": '<bsdf type="thindielectric"/>',
    "null": '<bsdf type="null"/>',
}
MIRROR = '<bsdf type="conductor"><string name="material" value="none"/></bsdf>'


def pane(bsdf):
    """Between the lamp and the wall, parallel to it."""
    return (
        f'<shape type="rectangle" id="pane">{bsdf}<transform name="to_world"><scale value="9"/>'
        '<rotate x="1" angle="90"/><translate y="0.2"/></transform></shape>'
    )


def floor(bsdf):
    return (
        f'<shape type="rectangle" id="floor">{bsdf}<transform name="to_world"><scale value="9"/>'
        '<translate z="-0.3"/></transform></shape>'
    )


@pytest.fixture
def scenario(room):
    return room.load(camera=room.camera((4, 4)), hidden=(1, 1))


@pytest.fixture
def place(room):
    """Write a place with a black wall."""

    def write(*parts):
        return room.write(*parts, wall=room.wall(BLACK), monitor="", camera=room.camera((4, 4)))

    return write


# -- what is refused -----------------------------------------------------------------------------

SENDS_ON = {
    **{kind: (bsdf, kind) for kind, bsdf in CLEAR.items()},
    "mirror": (f'<bsdf type="twosided">{MIRROR}</bsdf>', "conductor"),
    "blend": (
        f'<bsdf type="blendbsdf"><float name="weight" value="0.5"/>{BLACK}{MIRROR}</bsdf>',
        "conductor",
    ),
    "mask of a mirror": (masked(1, MIRROR), "conductor"),
}


def refusal(path, scenario, find=render_background):
    with pytest.raises(SceneError) as error:
        find(path, scenario, target=1.0)
    message = str(error.value)
    assert "\n" not in message
    return message


@pytest.mark.parametrize("kind", SENDS_ON)
def test_lamp_is_refused_by_name_among_what_sends_its_light_on(place, scenario, kind):
    bsdf, name = SENDS_ON[kind]
    message = refusal(place(LAMP, pane(bsdf)), scenario)
    assert "emitter 'bulb' (point) has no size" in message
    assert f"shape 'pane' (bsdf '{name}') would be missing; give the lamp a size" in message


def test_emitters_without_a_size_are_those_that_mitsuba_flags_so(variant):  # noqa: ARG001
    """Of all plugins of emitters that 3.9 has."""
    import mitsuba as mi

    sky = {"bitmap": mi.Bitmap(np.ones((4, 4, 3), np.float32))}
    kinds = {kind: {} for kind in ("area", "constant", "sunsky", "timed_sunsky", *SIZELESS)}
    for kind, inside in (kinds | {"envmap": sky}).items():
        emitter = {"type": kind, **inside}
        if kind in ("area", "directionalarea"):
            emitter = {"type": "rectangle", "emitter": emitter}
        (built,) = mi.load_dict({"type": "scene", "emitter": emitter}).emitters()
        assert mi.has_flag(built.flags(), mi.EmitterFlags.Delta) == (kind in SIZELESS), kind


def test_prototypes_are_refused_where_light_comes_through_a_shape(place, scenario):
    """Of them light straight on the wall is counted: behind glass none."""
    message = refusal(place(LAMP, pane(CLEAR["thindielectric"])), scenario, emitter_backgrounds)
    assert "shape 'pane' may let light through" in message
    assert emitter_backgrounds(place(LAMP, floor(MIRROR)), scenario, target=1.0).shape == (16, 1)
