from copy import copy

import numpy as np
import pytest
from periscopy_sim.calibration.consider_analysis import (
    UncertainParameters,
    require_effect,
    sensitivity,
    uncertain_parameters,
)
from periscopy_sim.calibration.search.fisher_information import Curvature
from periscopy_sim.calibration.search.levenberg_marquardt import descend

from periscopy_sim.calibration.prior import Prior
from periscopy_sim.errors import SceneError
from periscopy_sim.shipped import find_scene
from tests.calibration.conftest import NEAREST, TRUTH, SlatLevel

CHAIR = find_scene("chair")
STEPS = np.array([0.0025])


class HeldSlat(SlatLevel):
    """A slat whose distance stays where it is held, unless it varies."""

    names = ("middle",)
    held = TRUTH[1]

    def __init__(self, *arguments, **named):
        super().__init__(*arguments, **named)
        self.prior = Prior.none(1)

    def varying(self, names):
        other = copy(self)
        other.names = names
        return other

    def matrix(self, values, seed=None):
        distance = self.held if len(self.names) == 1 else values[1]
        return super().matrix(np.array([values[0], distance]), seed)


@pytest.fixture(autouse=True)
def errors_taken_for_white(monkeypatch):
    """A scene that is wrong leaves what tells little, and then nothing moves."""
    monkeypatch.setattr(Curvature, "overdispersion", lambda *_: 1.0)


def ignore(values, evidence):
    pass


def found(level):
    return descend(level, TRUTH[:1], STEPS, np.array([0.1]), 40, ignore)[1]


def distance(error, value=TRUTH[1]):
    return UncertainParameters(("distance",), np.array([value]), np.array([error]))


def test_values_move_as_when_another_number_is_changed_and_all_is_found_again():
    error = 0.01
    ends = []
    for held in (TRUTH[1] - error, TRUTH[1] + error):
        level = HeldSlat(noise=1e-3, seed=0)
        level.held = held
        ends.append(found(level).values[0])
    level = HeldSlat(noise=1e-3, seed=0)
    end = found(level)
    moves = sensitivity(level, end, distance(error))
    expected = (ends[1] - ends[0]) / 2
    assert abs(expected) > 1e-4
    np.testing.assert_allclose(moves, [[expected]], rtol=0.15)


def test_values_that_a_ruler_holds_move_less():
    error = 0.01
    level = HeldSlat(noise=1e-3, seed=0)
    free = found(level)
    level.prior = Prior(TRUTH[:1], free.curvature.information[0] ** -0.5)
    ruled = sensitivity(level, found(level), distance(error))
    np.testing.assert_allclose(ruled, sensitivity(level, free, distance(error)) / 2, rtol=0.15)


def test_without_uncertain_parameters_nothing_is_added():
    level = HeldSlat(noise=0.01, seed=1)
    nothing = uncertain_parameters(CHAIR, ("occluder_dx",), {}, {})
    assert sensitivity(level, found(level), nothing).shape == (1, 0)


def test_errors_through_the_wall_are_refused():
    level = HeldSlat(noise=0.01, seed=1)
    require_effect(level, TRUTH[:1], distance(0.9 * (TRUTH[1] - NEAREST)))
    with pytest.raises(SceneError, match="in the wall"):
        require_effect(level, TRUTH[:1], distance(1.1 * (TRUTH[1] - NEAREST)))


def test_errors_that_the_photograph_does_not_show_are_refused():
    class Unlit(HeldSlat):
        def matrix(self, values, seed=None):
            return super().matrix(np.array([values[0], TRUTH[1]]), seed)

    with pytest.raises(SceneError, match=r"distance=0\.1: the photograph does not show"):
        require_effect(Unlit(noise=0.01, seed=1), TRUTH[:1], distance(0.1))


def test_uncertain_parameters_stay_at_their_defaults_or_as_given():
    errors = {"occluder_turn": 2, "occluder_stretch_x": 0.03}
    uncertain = uncertain_parameters(CHAIR, ("occluder_dx",), {"occluder_turn": "-1.5"}, errors)
    assert uncertain.names == ("occluder_turn", "occluder_stretch_x")
    np.testing.assert_array_equal(uncertain.values, [-1.5, 1])
    np.testing.assert_array_equal(uncertain.standard_errors, [2, 0.03])


@pytest.mark.parametrize(
    ("errors", "message"),
    [
        ({"occluder_dx": 1}, "'occluder_dx' is both free"),
        ({"sofa_dx": 1}, "no parameter 'sofa_dx'"),
        ({"occluder_dy": 0}, "give a positive number"),
        ({"occluder_dy": np.inf}, "give a positive number"),
    ],
)
def test_what_cannot_be_uncertain_is_refused(errors, message):
    with pytest.raises(SceneError, match=message):
        uncertain_parameters(CHAIR, ("occluder_dx",), {}, errors)
