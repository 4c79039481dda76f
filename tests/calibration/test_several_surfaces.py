"""Scenes of several hidden surfaces: calibration, uncertain transport, silhouettes."""

import numpy as np
import pytest

import periscopy_sim as ps
from periscopy_sim.analytic.area_transport import area_transport
from periscopy_sim.calibration.moving_scene import MovingScene
from periscopy_sim.calibration.problem import shown_light
from periscopy_sim.errors import ClosedFormError
from periscopy_sim.numerics.validation import InputError
from periscopy_sim.rendering.load import load_scene
from tests.scenes.calibration import AMBIENT, SIDE
from tests.scenes.room import Room

SIZES = {"monitor": (6, 4), "hidden_card": (5, 3)}
"""Of the card, 0.1 m before the monitor and to its right."""

SCENE = """<default name="monitor_dy" value="0"/><default name="card_dy" value="0"/>
<default name="plate_dx" value="0"/>
<shape type="rectangle" id="hidden_card"><transform name="to_world">
<scale x="0.09" y="0.15"/><rotate x="1" angle="90"/><rotate z="1" angle="180"/>
<translate x="0.1" y="0.1" z="0.3"/><translate y="$card_dy"/></transform>
<emitter type="area"><rgb name="radiance" value="1"/></emitter></shape>
<shape type="rectangle" id="plate"><transform name="to_world"><scale x="0.05" y="0.04"/>
<rotate x="1" angle="90"/><translate x="0.45" y="0.6" z="0.3"/><translate x="$plate_dx"/>
</transform></shape>"""

TRUTH = {"monitor_dy": 0.012, "card_dy": -0.008}


@pytest.fixture
def scene(jit, tmp_path):  # noqa: ARG001
    room = Room(tmp_path)
    monitor = room.monitor(room.area, scale=(0.09, 0.15))
    monitor = monitor.replace('x="0.2" y="0"', 'x="0.3" y="$monitor_dy"')
    declared, rest = SCENE.split("\n", 1)
    return load_scene(
        room.write(
            rest, wall=declared + room.wall(), monitor=monitor, camera=room.camera((SIDE, SIDE))
        )
    )


@pytest.fixture
def images():
    return pictures(3)


def pictures(seed):
    rng = np.random.default_rng(seed)
    return [{n: 0.05 + rng.random((*size, 3)) ** 2 for n, size in SIZES.items()} for _ in range(2)]


def photograph(scenario, image, seed=0, across=1):
    light = area_transport(scenario.averaged(across)) @ scenario.hidden.vector(image)
    composite = ps.composite(light.reshape(SIDE, SIDE, 3), AMBIENT, 1.0)
    return ps.add_noise(composite, 60, seed)


@pytest.mark.usefixtures("quick")
@pytest.mark.parametrize("is_shown", [True, pytest.param(False, marks=pytest.mark.thorough)])
def test_the_depth_of_each_surface_is_found(scene, images, is_shown):
    """Unknown pictures of so few patches leave half a patch of their size, which is depth."""
    y = photograph(ps.load_scenario(scene, SIZES, TRUTH), images[0], across=3)
    shown = images[:1] if is_shown else []
    found = ps.calibrate(y, scene, SIZES, dict.fromkeys(TRUTH, 0.01), shown=shown)
    assert found.trusted and found.moved
    for each in found.parameters:
        assert each.standard_error < 0.005 or not is_shown
        assert each.value == pytest.approx(TRUTH[each.name], abs=1.5e-3)


def test_a_scene_without_closed_form_stops_at_once_by_the_shapes_name(scene):
    ball = Room.blocker().replace("</shape>", "</shape></scene>")
    path = scene.path.with_name("ball.xml")
    path.write_text(scene.path.read_text().replace("</scene>", ball))
    with pytest.raises(ClosedFormError, match=r"'ball' has no triangles.*calibration cannot"):
        ps.calibrate(np.ones((SIDE, SIDE, 3)), path, SIZES, {"card_dy": 0.01})


def test_pictures_are_shown_on_each_surface(scene, images):
    hidden = ps.load_scenario(scene, SIZES).hidden
    np.testing.assert_allclose(shown_light(images[0], hidden), hidden.vector(images[0]))
    with pytest.raises(InputError, match="hidden_card"):
        shown_light(images[0]["monitor"], hidden)


def test_errors_of_each_surface_change_the_light_as_differences_do(scene, images):
    scenario, errors = ps.load_scenario(scene, SIZES), {"monitor_dy": 2e-4, "card_dy": 3e-4}
    lights = ps.uncertain_transport(scenario, errors).lights(images[0])
    f = scenario.hidden.vector(images[0])
    for light, (name, error) in zip(lights, errors.items(), strict=True):
        ahead, behind = (
            area_transport(scenario.at(**{name: s * error})).astype(float) @ f for s in (1, -1)
        )
        change = (ahead - behind).T / 2
        assert np.linalg.norm(light - change) < 0.05 * np.linalg.norm(change)


def test_no_derivative_crosses_the_depth_at_which_one_surface_passes_the_other(scene):
    """A card so near the monitor's plane that half of the step would bring it behind."""
    scenario = ps.load_scenario(scene, SIZES)
    moving = MovingScene(scenario, ("card_dy",), np.array([0.01]))
    near = np.array([-0.1 - 1e-4])
    _, changes = moving.linearized(near)
    step = 2e-4
    ahead, behind = (moving.transport(near + d).astype(float) for d in (-step / 2, -3 * step / 2))
    change = (ahead - behind) / step
    assert np.linalg.norm(changes[0] - change) < 0.1 * np.linalg.norm(change)


def test_places_and_size_within_each_surface_are_free_in_standard_errors(scene):
    """The ends of the longer side, of n patches, move outwards: all grows by 1 + 2 w / n."""
    scenario = ps.load_scenario(scene, SIZES)
    moving = MovingScene(scenario, (), np.ones(6))
    moved = moving.at(np.array([1.0, 0.0, 0.5, 0.0, 2.0, -0.2])).hidden
    for name, (across, up, wider) in {"monitor": (1, 0, 0.5), "hidden_card": (0, 2, -0.2)}.items():
        surface = scenario.hidden[name]
        middle, scale = surface.centers.mean(axis=0), 1 + 2 * wider / max(surface.shape)
        expected = middle + scale * (surface.vertices - middle)
        expected += (across * surface.across + up * surface.up)[0]
        np.testing.assert_allclose(moved[name].vertices, expected, atol=1e-12)
