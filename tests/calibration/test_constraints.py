import dataclasses

import numpy as np
import pytest
from periscopy_sim.calibration.constraints import InFront

from periscopy_sim.errors import SceneError
from periscopy_sim.rendering.scene.load import load_scenario
from periscopy_sim.scenario import Occluder


def chair(**parameters):
    return load_scenario("chair", (4, 5), {"resolution": 20, **parameters})


def test_a_chair_before_the_wall_passes_wherever_it_stands():
    in_front = InFront(chair())
    for dy in (-0.3, 0.0, 0.3):
        in_front.check(chair(occluder_dy=dy))


def test_a_chair_that_comes_to_stand_in_the_wall_is_refused():
    # The seat ends at y = 0.594 + 0.075 of the wall's 1.03.
    message = r"'chair_seat' reaches 9 mm through the wall at .*dy = 0.37"
    with pytest.raises(SceneError, match=message):
        InFront(chair()).check(chair(occluder_dy=0.37))


def test_a_start_in_the_wall_is_refused():
    with pytest.raises(SceneError, match=r"'chair_seat' reaches 9 mm through the wall"):
        InFront(chair(occluder_dy=0.37))


def test_parameters_that_are_no_numbers_are_told_as_they_are():
    scenario = chair(occluder_dy=0.37)
    named = dataclasses.replace(scenario, parameters={**scenario.parameters, "mesh": "a.ply"})
    with pytest.raises(SceneError, match=r"at .*mesh = a\.ply"):
        InFront(named)


def test_a_floor_on_which_the_wall_stands_may_pass_below_it():
    scenario = chair()
    corners = np.array([[-2.0, -2, 0], [2, -2, 0], [2, 2, 0], [-2, 2, 0]])
    floor = Occluder("floor", corners, np.array([[0, 1, 2], [0, 2, 3]]))
    ball = Occluder("ball", None, None)
    with_floor = dataclasses.replace(scenario, occluders=(*scenario.occluders, floor, ball))
    InFront(with_floor).check(with_floor)
