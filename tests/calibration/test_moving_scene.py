from dataclasses import replace

import numpy as np
import pytest

import periscopy_sim as ps
from periscopy_sim.analytic.area_transport import area_transport
from periscopy_sim.calibration.moving_scene import MovingScene
from periscopy_sim.hidden import Hidden
from periscopy_sim.rendering.load import load_scene
from periscopy_sim.scenario import Scenario
from periscopy_sim.testing import derivative_test
from periscopy_sim.view import View
from tests.scenes.calibration import ERRORS, HIDDEN, SIDE

FINER = 2
VALUES = np.array([0.003, -0.002, 0.4])


@pytest.fixture(scope="module")
def scene() -> MovingScene:
    size = SIDE // FINER
    pixels = np.random.default_rng(0).random((size, size)) < 0.3
    world = load_scene("chair")
    view = View.of(world, (size, size), across=FINER)
    part = Scenario(view.of_pixels(pixels), Hidden.of_scene(world, HIDDEN))
    return MovingScene(part, tuple(ERRORS), np.array(list(ERRORS.values())))


def test_pixels_have_the_rows_of_the_whole_matrix(scene: MovingScene) -> None:
    given = {"resolution": SIDE, **dict(zip(scene.names, VALUES.tolist(), strict=True))}
    moved = ps.load_scenario("chair", HIDDEN, given)
    whole = area_transport(moved).astype(float)
    size = SIDE // FINER
    pixels = whole.reshape(size, FINER, size, FINER, -1).mean(axis=(1, 3))[scene.pixels]
    np.testing.assert_allclose(scene.transport(VALUES), pixels, rtol=1e-5, atol=1e-5 * pixels.max())


def test_derivatives_are_those_of_differences(scene: MovingScene) -> None:
    """As far as A, in single precision and with corners, has any; `test_border_motion` has more."""
    A, changes = scene.linearized(VALUES)
    np.testing.assert_array_equal(A, scene.transport(VALUES))
    derivative_test(scene.transport, changes, VALUES, steps=0.02 * scene.errors, rtol=0.02)


def test_a_chair_behind_the_wall_hides_nothing(scene: MovingScene) -> None:
    wall = MovingScene(scene.scenario, ("occluder_dy",), np.ones(1))
    bare = scene.scenario.scene
    for chair in bare.occluders:
        bare = bare.without(chair.name)
    free = Scenario(replace(scene.scenario.view, scene=bare), scene.scenario.hidden)
    np.testing.assert_allclose(wall.transport(np.array([3.0])), area_transport(free), rtol=1e-3)
