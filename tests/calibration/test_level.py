from dataclasses import replace

import numpy as np
import pytest
from scipy.stats import chi2

import periscopy_sim as ps
from periscopy_sim.analytic.area_transport import pixel_transport
from periscopy_sim.calibration.level import SPREAD, Group
from periscopy_sim.calibration.prior import UncertainParameters, free_parameters, ruled_values
from periscopy_sim.calibration.problem import CalibrationProblem
from periscopy_sim.calibration.search import descend
from periscopy_sim.photograph import Photograph
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


@pytest.mark.parametrize("channels", [1, 3, 4])
def test_photographs_are_counted_in_any_number_of_channels(small: Small, channels: int) -> None:
    level = small.level(shown=1, count=2)
    groups = tuple(Group(np.ones((k, 5, channels)), level.groups[0].images) for k in (1, 2))
    assert replace(level, groups=groups).photographs == 3


def test_a_newton_step_gains_what_it_promises(small: Small) -> None:
    """Near the minimum the information is the curvature of the objective."""
    level = small.level(shown=1)
    end = level.look(level.candidate(level.center))
    for _ in range(3):
        end = descend(level, end, 1.0)
    values = level.values(end.point)
    np.testing.assert_allclose(values, list(TRUTH.values()), atol=0.2 * np.max(level.errors))
    away = end.point + 2 / np.sqrt(np.diag(end.curvature()))
    look = level.look(level.candidate(away))
    assert look.objective - end.objective == pytest.approx(look.predicted_gain, rel=0.1)


def test_the_last_level_has_no_slope_at_the_truth_but_by_noise(jit: None) -> None:  # noqa: ARG001
    """Its score has the χ² distribution; that of the likeliest image alone has not (p < 1e-4)."""
    hidden, size = (29, 36), {"resolution": "63"}
    scene = ps.load_scenario("plate", hidden, size)
    errors = free_parameters(scene.document)
    names = tuple(errors)
    centers = ruled_values(scene.document, names)
    picture = ps.read_hidden_image(ps.find_image("still_life"), hidden)
    light = (pixel_transport(scene) @ picture.reshape(-1, 3)).reshape(63, 63, 3)
    y = ps.add_noise(ps.composite(light, np.ones_like(light), 0.5), 60, 1)
    held = UncertainParameters((), np.zeros(0), np.zeros(0))
    deviations = np.array(list(errors.values()))
    fine = CalibrationProblem(
        scene, names, centers, deviations, held, [Photograph.of(y)], ()
    ).fine()
    scores = []
    for level in (fine, fine.with_edges(fine.candidate(fine.center))):
        look = level.look(level.candidate(fine.center))
        spread = look.information + np.diag(
            look.precision
        )  # what it would be with no prior, at most
        scores.append(float(look.slope @ np.linalg.solve(spread, look.slope)))
    threshold = chi2.isf(1e-4, len(fine.center))
    assert scores[0] > 3 * threshold
    assert scores[1] < threshold


def test_the_prior_is_normal(small: Small) -> None:
    level = small.level()
    for k, error in enumerate(ERRORS.values()):
        point = level.center.copy()
        point[k] += 2 * error
        assert level.penalty(point) == pytest.approx(4)
