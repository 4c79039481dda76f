from copy import copy
from unittest.mock import Mock

import numpy as np
import pytest

from periscopy_sim.calibration.levenberg_marquardt import (
    Curvature,
    Descent,
    curvature,
    descend,
    settle,
)
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


def test_errors_are_as_large_as_told(slat_level):
    # Squares of 60 normal errors average to 1 ± 0.18; half has a probability of 3e-4, twice less.
    normalized = []
    for seed in range(30):
        level = slat_level(noise=0.002, seed=seed)
        start = TRUTH + 0.01 * np.random.default_rng(seed).standard_normal(2)
        end = descend(level, start, STEPS / 4, LONGEST, 20, ignore)
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
    assert not np.array_equal(values, early)
    with_wall = copy(level)
    with_wall.explain = Mock(side_effect=SceneError("the slat is in the wall"))
    assert settle(with_wall, stopped, about, LONGEST)[0] is early


def test_a_step_that_other_rays_do_not_confirm_is_not_taken(slat_level):
    # So much noise of the rendering makes steps of many standard errors up.
    refused = 0
    for seed in range(8):
        level = slat_level(noise=0.002, seed=seed, rendering=1e-3)
        end = Descent(TRUTH, level.explain(TRUTH), None)
        about = curvature(level, TRUTH, end.explanation, STEPS / 4)
        values, _ = settle(level, end, about, LONGEST)
        refused += values is TRUTH
        other = [level.explain(place, seed + 2).evidence for place in (values, TRUTH)]
        assert other[0] <= other[1]
    assert refused >= 1


def test_what_rays_add_is_in_the_errors():
    about = Curvature(
        slope=np.zeros(1),
        information=np.array([[4.0]]),
        noisy=np.array([4.0]),
        scores=np.zeros((5, 1)),
        scatter=np.array([6.0]),
    )
    np.testing.assert_allclose(about.covariance(), [[1 / 4 + (6 / 4) ** 2]], rtol=1e-3)


def test_the_slopes_scatter_is_that_of_other_rays(slat_level):
    # Of F's distribution with 40 and 39 degrees, 97 % is within a factor of 2; two are looked at.
    level = slat_level(noise=0.002, seed=0, rendering=5e-4)
    explanation = level.explain(TRUTH)
    slopes, squares = [], []
    for seed in range(40):
        level.seed = 10 * seed
        about = curvature(level, TRUTH, explanation, STEPS / 4)
        slopes.append(about.slope)
        squares.append(about.scatter**2)
    ratio = np.mean(squares, axis=0) / np.var(slopes, axis=0, ddof=1)
    assert (ratio > 0.5).all() and (ratio < 2).all(), ratio


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
