from types import SimpleNamespace

import numpy as np
import pytest
from periscopy_sim.calibration.search.physical_step import PARTS, physical_step

from periscopy_sim.errors import SceneError

HERE = np.zeros(5)
STEP = np.array([1.0, 2.0, 3.0, 4.0, 5.0])


def bordered(is_beyond):
    """A level on which some values are not physical; it counts how often it was asked."""
    level = SimpleNamespace(asked=0)

    def unphysical(values):
        level.asked += 1
        return SceneError("inside out") if is_beyond(values) else None

    level.unphysical = unphysical
    return level


def test_a_physical_step_is_taken_as_it_is():
    level = bordered(lambda _: False)
    step, error = physical_step(level, HERE, STEP, lambda _: pytest.fail("asked for"))
    assert step is STEP and error is None and level.asked == 1


def test_numbers_that_cross_the_border_go_a_part_of_the_way_and_the_others_by_themselves():
    """The second may go 0.25 of 2, the fifth not even 0.0625 of 5."""
    level = bordered(lambda values: values[1] > 0.6 or values[4] > 0.1)
    asked = []

    def step_of(free):
        asked.append(free.tolist())
        return -STEP[free]

    step, error = physical_step(level, HERE, STEP, step_of)
    assert asked == [[True, False, True, True, False]]
    assert step.tolist() == [-1.0, PARTS[0] * 2.0, -3.0, -4.0, 0.0]
    assert str(error) == "inside out"


def test_one_of_many_is_found_by_a_few_scenes():
    many = np.ones(64)
    level = bordered(lambda values: values[37] > 0.9)
    step, _ = physical_step(level, 0 * many, many, lambda free: many[free])
    assert step[37] == PARTS[0] and np.delete(step, 37).min() == 1
    assert level.asked < 16


@pytest.mark.parametrize(
    "is_beyond",
    [
        lambda values: values.sum() > 14,  # none by itself
        lambda values: values.any(),  # each of them
    ],
)
def test_where_none_or_all_cross_it_the_step_is_left_as_it_is(is_beyond):
    step, error = physical_step(bordered(is_beyond), HERE, STEP, lambda free: STEP[free])
    assert step is STEP and error is not None


def test_a_lone_number_past_the_border_is_left_as_it_is():
    level = bordered(lambda values: values[0] > 0)
    step, error = physical_step(level, HERE[:1], STEP[:1], lambda free: STEP[:1][free])
    assert step.tolist() == [1.0] and error is not None
