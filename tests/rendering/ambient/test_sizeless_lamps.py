"""Lamps without a size among clear shapes and mirrors: refused, since paths would miss their light.

Beside them a sphere that shines as much: its irradiance of what faces it, I cos θ / r², is the
lamp's at any radius.
"""

import numpy as np
import pytest

from periscopy_sim.errors import SceneError
from periscopy_sim.rendering.ambient.background import render_background
from periscopy_sim.rendering.ambient.emitter_backgrounds import emitter_backgrounds
from periscopy_sim.rendering.scene.refusals import SIZELESS
from tests.rendering.materials import BUMPS, write_files

pytestmark = pytest.mark.usefixtures("jit")

PLACE, RADIUS = np.array([0.2, -0.5, 0.9]), 0.4
LAMP = (
    '<emitter type="point" id="bulb"><point name="position" value="0.2, -0.5, 0.9"/>'
    '<rgb name="intensity" value="1"/></emitter>'
)
GLOBE = (
    '<shape type="sphere" id="globe"><point name="center" value="0.2, -0.5, 0.9"/>'
    f'<float name="radius" value="{RADIUS}"/><emitter type="area"><rgb name="radiance" '
    f'value="{1 / (np.pi * RADIUS**2)}"/></emitter></shape>'
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
ROUGH_GLASS = '<bsdf type="roughdielectric"><float name="alpha" value="0.3"/></bsdf>'
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


def let_through(kind, cosine):
    """Part of the light that a shape lets through: of thin glass after all its reflections."""
    if kind != "thindielectric":
        return {"mask": 0.7, "null": 1}[kind]
    eta = 1.5046 / 1.000277
    within = np.sqrt(1 - (1 - cosine**2) / eta**2)
    s, p = (cosine - eta * within), (eta * cosine - within)
    once = ((s / (cosine + eta * within)) ** 2 + (p / (eta * cosine + within)) ** 2) / 2
    return 1 - 2 * once / (1 + once)


@pytest.fixture
def scenario(room):
    return room.load(camera=room.camera((4, 4)), hidden=(1, 1))


@pytest.fixture
def place(room):
    """Write a place with a black wall."""

    def write(*parts):
        return room.write(*parts, wall=room.wall(BLACK), monitor="", camera=room.camera((4, 4)))

    return write


def irradiance(scenario, source=PLACE):
    """I cos θ / r² of a lamp there, and cos θ, at the wall's points."""
    away = source - scenario.wall_points
    distance = np.linalg.norm(away, axis=1)
    cosine = -away[:, 1] / distance
    return cosine / distance**2, cosine


@pytest.mark.parametrize("kind", CLEAR)
def test_a_globe_shines_through_a_clear_pane_and_a_lamp_does_not(
    room, place, scenario, mitsubas, kind
):
    direct, cosine = irradiance(scenario)
    expected = 0.5 / np.pi * np.mean(direct * let_through(kind, cosine))
    found = render_background(place(GLOBE, pane(CLEAR[kind])), scenario, target=1e-2)
    assert found.photograph.mean() == pytest.approx(expected, rel=0.04)
    with_lamp = room.write(LAMP, pane(CLEAR[kind]), monitor="")
    assert np.max(mitsubas(with_lamp, seeds=1, samples=256, type="path")) == 0


def test_a_globe_shines_by_way_of_a_mirror_and_a_lamp_does_not(room, place, scenario, mitsubas):
    images = PLACE, PLACE * [1, 1, -1] - [0, 0, 0.6]
    expected = 0.5 / np.pi * sum(irradiance(scenario, image)[0].mean() for image in images)
    found = render_background(place(GLOBE, floor(MIRROR)), scenario, target=1e-2)
    assert found.photograph.mean() == pytest.approx(expected, rel=0.04)
    with_lamp = room.write(LAMP, floor(MIRROR), monitor="", camera=room.camera((4, 4)))
    traced = np.mean(mitsubas(with_lamp, seeds=1, samples=1024, type="path"))
    assert traced == pytest.approx(0.5 / np.pi * irradiance(scenario)[0].mean(), rel=0.01)
    assert traced < 0.9 * expected


def test_a_lamp_shines_through_rough_glass_as_a_globe_does(place, scenario):
    lamp, globe = (
        render_background(place(light, pane(ROUGH_GLASS)), scenario, target=2e-2).photograph.mean()
        for light in (LAMP, GLOBE)
    )
    assert lamp == pytest.approx(globe, rel=0.08)


# -- what is refused -----------------------------------------------------------------------------

SENDS_ON = {
    **{kind: (bsdf, kind) for kind, bsdf in CLEAR.items()},
    "glass": ('<bsdf type="dielectric"/>', "dielectric"),
    "mirror": (f'<bsdf type="twosided">{MIRROR}</bsdf>', "conductor"),
    "plastic": ('<bsdf type="plastic"/>', "plastic"),
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


@pytest.mark.parametrize(
    "bsdf",
    [
        f'<bsdf type="twosided">{DIFFUSE}</bsdf>',
        f'<bsdf type="blendbsdf"><float name="weight" value="0.5"/>{BLACK}{DIFFUSE}</bsdf>',
        masked(1, DIFFUSE),
        BUMPS,
        '<bsdf type="roughconductor"/>',
        '<bsdf type="roughplastic"/>',
        '<bsdf type="principled"/>',
    ],
    ids=["twosided", "blend", "full mask", "bumps", "rough metal", "rough plastic", "principled"],
)
def test_lamp_is_taken_among_what_scatters_all_it_reflects(room, place, scenario, bsdf):
    write_files(room.folder)
    found = render_background(place(LAMP, floor(bsdf)), scenario, target=1.0)
    assert found.photograph.mean() > 0


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


@pytest.mark.parametrize("light", [LAMP, GLOBE])
def test_prototypes_are_refused_where_light_comes_through_a_shape(place, scenario, light):
    """Of them light straight on the wall is counted: behind glass none, also of a globe."""
    for bsdf in (CLEAR["thindielectric"], ROUGH_GLASS):
        message = refusal(place(light, pane(bsdf)), scenario, emitter_backgrounds)
        assert "shape 'pane' may let light through" in message
    assert emitter_backgrounds(place(light, floor(MIRROR)), scenario, target=1.0).shape == (16, 1)
