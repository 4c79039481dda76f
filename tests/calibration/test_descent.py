from copy import copy
from unittest.mock import Mock

import numpy as np
import pytest

from periscopy_sim.calibration.descent import Descent, curvature, descend, settle
from periscopy_sim.errors import SceneError
from tests.calibration.conftest import NEAREST, TRUTH

STEPS = np.array([0.01, 0.01])
LONGEST = np.array([0.1, 0.1])


def ignore(values, evidence):
    pass


@pytest.mark.parametrize("start", [(0.1, 0.45), (-0.1, 0.3), (0.0, 0.4)])
def test_it_ends_at_the_truth_where_noise_is_low(slat_level, start):
    level = slat_level(noise=1e-4, seed=0)
    end = descend(level, np.array(start), STEPS / 10, LONGEST, 60, ignore)
    np.testing.assert_allclose(end.values, TRUTH, atol=3e-3)
    assert end.unphysical is None


@pytest.mark.parametrize("rendering", [0.0, 2e-4])
def test_errors_are_as_large_as_told(slat_level, rendering):
    # Squares of 60 normal errors average to 1 ± 0.18; a factor of 2 either way is 4 sigma.
    normalized = []
    for seed in range(30):
        level = slat_level(noise=0.002, seed=seed, rendering=rendering)
        end = descend(level, TRUTH, STEPS / 4, LONGEST, 20, ignore)
        about = curvature(level, end.values, end.explanation, STEPS / 4)
        values, _ = settle(level, end, about, LONGEST)
        normalized.append((values - TRUTH) ** 2 / np.diag(about.covariance()))
    mean = np.mean(normalized)
    assert 0.5 < mean < 2, mean


def test_noise_of_the_rendering_is_not_taken_for_information(slat_level):
    clean, noisy = slat_level(0.01, seed=1), slat_level(0.01, seed=1, rendering=4e-4)
    there = clean.explain(TRUTH)
    expected = np.diag(curvature(clean, TRUTH, there, STEPS / 4).information)
    about = curvature(noisy, TRUTH, there, STEPS / 4)
    assert (about.noisy > 1.5 * expected).all()  # what one rendering alone would tell
    np.testing.assert_allclose(np.diag(about.information), expected, rtol=0.5)


def test_a_descent_that_ended_early_is_settled(slat_level):
    level = slat_level(noise=0.002, seed=6)
    end = descend(level, TRUTH, STEPS / 4, LONGEST, 40, ignore)
    error = np.sqrt(np.diag(curvature(level, end.values, end.explanation, STEPS / 4).covariance()))
    early = end.values + error
    stopped = Descent(early, level.explain(early), None)
    about = curvature(level, early, stopped.explanation, STEPS / 4)
    values, explanation = settle(level, stopped, about, LONGEST)
    assert (np.abs(values - end.values) < 0.3 * error).all()
    assert explanation.evidence < stopped.explanation.evidence
    with_wall = copy(level)
    with_wall.explain = Mock(side_effect=SceneError("the slat is in the wall"))
    assert settle(with_wall, stopped, about, LONGEST)[0] is early


def test_what_cannot_be_told_apart_has_large_errors(slat_level):
    level = slat_level(noise=0.01, seed=2)
    both = slat_level(noise=0.01, seed=2)
    both.matrix = lambda values, seed=None: level.matrix(
        np.array([values[0] + values[1], TRUTH[1]]), seed
    )
    values = np.array([TRUTH[0], 0.0])
    alone = curvature(level, TRUTH, level.explain(TRUTH), STEPS).covariance()
    told = curvature(both, values, level.explain(TRUTH), STEPS).covariance()
    assert (np.diag(told) > 100 * alone[0, 0]).all()
    assert told[0, 1] / np.sqrt(told[0, 0] * told[1, 1]) < -0.99


def test_visits_go_downhill(slat_level):
    visited = []

    def visit(values, evidence):
        visited.append((*values, evidence))

    level = slat_level(noise=0.01, seed=3)
    end = descend(level, np.array([0.2, 0.5]), STEPS, LONGEST, 30, visit)
    assert len(visited) > 2
    assert (np.diff([evidence for *_, evidence in visited]) < 0).all()
    assert visited[-1] == (*end.values, end.explanation.evidence)
    assert end.explanation.evidence == level.explain(end.values).evidence


def test_a_search_that_wants_to_leave_the_physical_ends_at_its_border_and_says_so(slat_level):
    # The truth, at a distance of 0.4, lies beyond a wall moved to 0.45.
    level = slat_level(noise=1e-3, seed=4)
    whole = level.matrix

    def within(values, seed=None):
        if values[1] < 0.45:
            raise SceneError("the slat is in the wall")
        return whole(values, seed)

    level.matrix = within
    end = descend(level, np.array([0.08, 0.47]), STEPS / 10, LONGEST, 60, ignore)
    assert "in the wall" in str(end.unphysical)
    assert end.values[1] == pytest.approx(0.45, abs=5e-3)


def test_slopes_are_taken_to_one_side_at_a_border(slat_level):
    level = slat_level(noise=0.01, seed=5)
    values, step = np.array([0.1, NEAREST + 1e-4]), np.array([0.0, 1e-3])
    about = curvature(level, values, level.explain(values), np.array([1e-3, 1e-3]))
    numeric = (level.evidence(values + step) - level.evidence(values)) / 1e-3 / 2
    assert about.slope[1] == pytest.approx(numeric, rel=0.2)
