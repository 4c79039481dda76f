from copy import copy
from dataclasses import replace
from types import SimpleNamespace

import numpy as np
import pytest
from periscopy_sim.calibration.search.fisher_information import curvature, differences
from periscopy_sim.calibration.search.levenberg_marquardt import (
    DAMPING,
    LONGEST_STEP,
    SEEDS,
    TRIALS,
    Descent,
    _extended,
    _physical_step,
    descend,
    settle,
)

from periscopy_sim.errors import SceneError
from tests.calibration.conftest import TRUTH

STEPS = np.array([0.01, 0.01])
LONGEST = np.array([0.1, 0.1])


def ignore(values, evidence):
    pass


def ended(level, values):
    explanation = level.explain(values)
    about = curvature(level, values, explanation, differences(level, values, np.diag(STEPS / 4)))
    return Descent(values, explanation, about, None)


@pytest.mark.parametrize("start", [(0.1, 0.45), (-0.1, 0.3), (0.0, 0.4)])
def test_it_ends_at_the_truth_where_noise_is_low(slat_level, start):
    level = slat_level(noise=1e-4, seed=0)
    _, end = descend(level, np.array(start), STEPS / 10, LONGEST, 60, ignore)
    np.testing.assert_allclose(end.values, TRUTH, atol=3e-3)
    assert end.unphysical is None


@pytest.mark.parametrize(("overrated", "part"), [(1.0, 1.0), (3.0, 3.0), (100.0, LONGEST_STEP)])
def test_steps_that_are_too_short_are_extended_to_the_bottom(overrated, part):
    """E = (x − 1)², whose curvature is told too large: Newton's step is as much too short."""
    level = SimpleNamespace(judged=lambda at: SimpleNamespace(evidence=float((at[0] - 1) ** 2)))
    step, start = np.array([1 / overrated]), np.zeros(1)
    rate = -2 * float(step[0])
    found, seen = _extended(level, start, step, rate, level.judged(start), level.judged(step))
    assert found == pytest.approx(part * step)
    assert seen.evidence == level.judged(found).evidence


def test_a_step_past_which_nothing_is_physical_is_not_extended():
    def explain(at):
        if at[0] > 0.5:
            raise SceneError("the slat is in the wall")
        return SimpleNamespace(evidence=float((at[0] - 1) ** 2))

    start, step = np.zeros(1), np.array([0.3])
    ends = explain(start), explain(step)
    found, seen = _extended(SimpleNamespace(judged=explain), start, step, -0.6, *ends)
    assert found is step and seen is ends[1]


def test_a_descent_that_ended_early_is_settled(slat_level):
    level = slat_level(noise=0.002, seed=6)
    _, end = descend(level, TRUTH, STEPS / 4, LONGEST, 40, ignore)
    error = 1 / np.sqrt(np.diag(end.curvature.information))
    early = end.values + error
    stopped = ended(level, early)
    values, explanation = settle(level, stopped, LONGEST)
    assert (np.abs(values - end.values) < 0.3 * error).all()
    assert explanation.evidence < stopped.explanation.evidence
    assert not np.array_equal(values, early)
    with_wall = copy(level)

    def walled(place, seed=None):
        if place is not early:
            raise SceneError("the slat is in the wall")
        return level.explain(place, seed)

    with_wall.explain = with_wall.judged = walled
    assert settle(with_wall, stopped, LONGEST)[0] is early


def test_a_step_that_other_rays_do_not_confirm_is_not_taken(slat_level):
    # So much noise of the rendering makes steps of many standard errors up.
    refused = 0
    for seed in range(8):
        level = slat_level(noise=0.002, seed=seed, rendering=1e-3)
        values, _ = settle(level, ended(level, TRUTH), LONGEST)
        refused += values is TRUTH
        other = [level.explain(place, seed + 2).evidence for place in (values, TRUTH)]
        assert other[0] <= other[1]
    assert refused >= 1


def test_where_a_descent_settles_is_explained_by_the_rays_of_the_level(slat_level):
    taken = set()
    for seed in range(8):
        level = slat_level(noise=0.002, seed=seed, rendering=1e-3)
        end = ended(level.reseeded(seed + SEEDS), TRUTH)
        values, explanation = settle(level, end, LONGEST)
        taken.add(values is not TRUTH)
        assert explanation.evidence == level.explain(values).evidence
    assert taken == {False, True}


def test_visits_go_downhill(slat_level):
    visited = []

    def visit(values, evidence):
        assert np.isfinite(evidence)  # by discrepancies that differ, so that they do not compare
        visited.append(values)

    level = slat_level(noise=0.01, seed=3)
    last, end = descend(level, np.array([0.2, 0.5]), STEPS, LONGEST, 30, visit)
    assert len(visited) > 2
    assert visited[0].tolist() == [0.2, 0.5] and (visited[-1] == end.values).all()
    assert (np.diff([level.explain(values).evidence for values in visited]) < 0).all()
    assert end.explanation.evidence == last.explain(end.values).evidence


def test_steps_that_lead_uphill_are_shortened(slat_level):
    level, start = slat_level(noise=1e-3, seed=3), np.array([0.1, 0.45])
    whole, visited = level.explain, []

    def walled(values, seed=None):
        found = whole(values, seed)
        height = 1e6 * (np.abs(values - start).max() > 0.02)
        return replace(found, evidence=found.evidence + height)

    level.explain = level.judged = walled
    _, end = descend(
        level, start, STEPS / 4, LONGEST, 5, lambda _, evidence: visited.append(evidence)
    )
    assert len(visited) > 1 and (np.diff(visited) < 0).all()
    assert 0.005 < np.abs(end.values - start).max() <= 0.02
    assert end.unphysical is None


def test_steps_are_doubled_while_that_gains(slat_level):
    level, start, longest = slat_level(noise=1e-3, seed=3), np.array([0.15, 0.4]), LONGEST / 10
    last, end = descend(level, start, STEPS / 4, longest, 1, ignore)
    assert 3 * longest[0] < np.abs(end.values - start).max() <= 8 * longest[0]
    assert end.explanation.evidence == last.explain(end.values).evidence


def test_a_search_that_wants_to_leave_the_physical_ends_at_its_border_and_says_so(slat_level):
    # The truth, at a distance of 0.4, lies beyond a wall moved to 0.45.
    level = slat_level(noise=1e-3, seed=4)
    whole = level.matrix

    def within(values, seed=None):
        if values[1] < 0.45:
            raise SceneError("the slat is in the wall")
        return whole(values, seed)

    level.matrix = within
    _, end = descend(level, np.array([0.08, 0.47]), STEPS / 10, LONGEST, 60, ignore)
    assert "in the wall" in str(end.unphysical)
    assert end.values[1] == pytest.approx(0.45, abs=5e-3)


@pytest.mark.parametrize(("border", "part"), [(0.4499, 0.0), (0.44, 0.25)])
def test_a_parameter_at_the_border_of_the_physical_does_not_hold_up_others(
    slat_level, border, part
):
    """The second wants to go from 0.45 to 0.4; the first goes where that is best without it."""
    level, start = slat_level(noise=1e-3, seed=4), np.array([0.08, 0.45])
    about = ended(level, start).curvature
    whole = about.step(DAMPING, LONGEST / 3)
    assert start[1] + whole[1] < border
    level.unphysical = lambda values: SceneError("the wall") if values[1] < border else None
    step, error = _physical_step(level, about, start, DAMPING, LONGEST / 3)
    alone = about.of(np.array([True, False])).step(DAMPING, LONGEST[:1] / 3)
    assert step == pytest.approx([alone[0], part * whole[1]])
    assert step[0] != pytest.approx(whole[0], rel=1e-3) and "the wall" in str(error)


@pytest.mark.parametrize("beyond", [False, True])
def test_a_step_that_all_or_none_may_take_is_left_as_it_is(slat_level, beyond):
    level, start = slat_level(noise=1e-3, seed=4), np.array([0.08, 0.45])
    about = ended(level, start).curvature
    level.unphysical = lambda _: SceneError("the wall") if beyond else None
    step, error = _physical_step(level, about, start, DAMPING, LONGEST)
    assert step == pytest.approx(about.step(DAMPING, LONGEST))
    assert (error is not None) == beyond


def search_that_nothing_betters(level, is_beyond):
    """Descend where no step is better, the n-th refused if `is_beyond(n)`; also count the steps."""
    start, whole, trials = np.array([0.1, 0.45]), level.explain, []

    def bordered(values, seed=None):
        found = whole(values, seed)
        if np.array_equal(values, start):
            return found
        trials.append(values)
        if is_beyond(len(trials)):
            raise SceneError(f"step {len(trials)} ends in the wall")
        return replace(found, evidence=found.evidence + 1e6)

    level.explain = bordered
    _, end = descend(level, start, STEPS / 4, LONGEST, 5, ignore)
    assert end.values is start
    return end, len(trials)


@pytest.mark.parametrize("beyond", [1, 2, TRIALS])
def test_a_border_that_also_stops_shorter_steps_is_told_of(slat_level, beyond):
    level = slat_level(noise=1e-3, seed=3)
    end, trials = search_that_nothing_betters(level, lambda n: n <= beyond)
    assert trials == TRIALS
    assert str(end.unphysical) == "step 1 ends in the wall"


def test_a_border_beyond_the_shorter_steps_alone_is_not_what_stops_a_descent(slat_level):
    level = slat_level(noise=1e-3, seed=3)
    end, trials = search_that_nothing_betters(level, lambda n: n > 1)
    assert trials == TRIALS and end.unphysical is None
