"""The objective of photographs, and its derivatives."""

import numpy as np
import pytest

from periscopy_sim.calibration.level import SPREAD
from periscopy_sim.calibration.search import descend
from tests.calibration.conftest import ERRORS, TRUTH, Small

POINT = np.array([0.003, -0.004, 0.2, 0.05, -0.03, 0.04, 0.02, -0.05])


@pytest.mark.parametrize(("shown", "count"), [(0, 1), (1, 2)])
def test_slope_is_the_derivative_of_the_objective(small: Small, shown: int, count: int) -> None:
    """Of parameters and gain, with an unknown picture alone and beside a known one."""
    level, temperature = small.level(shown, count), 3.0
    look = level.look(level.candidate(POINT), temperature)
    steps = np.append(0.02 * level.errors, np.full(5, 0.02 * SPREAD))
    for k, step in enumerate(np.diag(steps)):
        candidates = [level.candidate(POINT + side) for side in (step, -step)]
        sides = [each.objective_at(temperature) for each in candidates]
        numeric = (sides[0] - sides[1]) / (4 * steps[k])
        assert look.downhill[k] == pytest.approx(numeric, rel=0.1)


def test_a_newton_step_gains_what_it_promises(small: Small) -> None:
    """Near the minimum the information is the curvature of the objective."""
    level = small.level(shown=1)
    end = level.look(level.candidate(level.center))
    for _ in range(3):
        end = descend(level, end, 1.0, lambda _: None)
    values = level.values(end.point)
    np.testing.assert_allclose(values, list(TRUTH.values()), atol=0.2 * np.max(level.errors))
    away = end.point + 2 / np.sqrt(np.diag(end.curvature()))
    look = level.look(level.candidate(away))
    assert look.objective - end.objective == pytest.approx(look.predicted_gain, rel=0.1)


def test_the_prior_is_normal(small: Small) -> None:
    level = small.level()
    for k, error in enumerate(ERRORS.values()):
        point = level.center.copy()
        point[k] += 2 * error
        assert level.penalty(point) == pytest.approx(4)
