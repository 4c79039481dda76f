from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest
from scipy.stats import chi2

from periscopy_sim.calibration import trust
from periscopy_sim.calibration.resolution_level import Look
from periscopy_sim.calibration.result import LEARNED

NAMES = ("dx", "dy")


def look(information: Any = None, explanation: Any = None) -> Look:
    """Return a look at two parameters whose prior has a unit error."""
    nothing = np.zeros(2)
    information = np.eye(2) if information is None else information
    return Look(nothing, (explanation,), 0.0, nothing, nothing, information, np.ones(2))


def test_what_nothing_speaks_against_is_not_doubted() -> None:
    assert trust.doubts(NAMES, np.array([2.9, -2.9]), 1.0, np.array([0.1])) == ()


@pytest.mark.parametrize(
    ("distances", "known", "misfit"),
    [
        ([18.0, 0.0], 1.0, 0.1),
        ([-18.0, 0.0], 1.0, 0.1),
        ([0.0, 0.0], 0.9 * LEARNED, 0.1),
        ([0.0, 0.0], 1.0, 1.1 * trust.MISFIT),
    ],
)
def test_each_reason_is_a_doubt(distances: list[float], known: float, misfit: float) -> None:
    (doubt,) = trust.doubts(NAMES, np.array(distances), known, np.array([misfit]))
    assert ("dx" in doubt) == (distances[0] != 0) and "dy" not in doubt


def test_an_error_counts_how_far_an_uncertain_number_moves_it() -> None:
    """The photograph knows 99 / σ² of the number, and 60 of it together with the fixed one."""
    joint = look(np.array([[99.0, 60.0], [60.0, 50.0]]))
    uncertain = SimpleNamespace(standard_errors=np.array([0.5]))
    problem: Any = SimpleNamespace(names=("dx",), errors=np.ones(1), uncertain=uncertain)
    alone, total, _, moves = trust.standard_errors(problem, joint)
    assert moves == pytest.approx(-0.5 * 60 / 100) and alone == pytest.approx(trust.MARGIN / 10)
    assert total**2 == pytest.approx(alone**2 + moves[0] ** 2)


def test_misfits_are_of_each_photograph_s_light_beyond_noise() -> None:
    random = np.random.default_rng(0)
    count, noise = 5000, np.array([1, 2, 3, 1, 2, 3.0])
    light = 10 * random.standard_normal((count, 6))
    unexplained = np.array([0.0, 0.0, 0.0, 0.5, 0.5, 0.5]) * light
    grain = noise * random.standard_normal((count, 6))
    explanation = SimpleNamespace(
        residual=unexplained + grain,
        energy=np.sum((light + grain) ** 2, axis=0),
        background=np.zeros((count, 0)),
    )
    found = trust.misfits(look(explanation=explanation), noise.reshape(2, 3))
    # The mean of 15,000 squares of noise errs by 1 %, of 300 beside 30,000 of light.
    np.testing.assert_allclose(found, [0, 0.5], atol=0.05)
    (doubt,) = trust.doubts(NAMES, np.zeros(2), 1.0, found)
    assert "photograph 2" in doubt


def test_as_many_parameters_are_learned_as_photographs_determine() -> None:
    assert trust.determined_count(look(np.diag([1e4, 1e-4])), 2) == pytest.approx(1, abs=1e-3)
    assert trust.determined_count(look(), 2) == pytest.approx(1)
    together = 1e6 * np.ones((2, 2))  # their sum alone
    assert trust.determined_count(look(together), 2) == pytest.approx(1, abs=1e-3)


@pytest.mark.parametrize("parameters", [1, 6])
def test_gains_by_chance_pass_once_in_a_hundred(parameters: int) -> None:
    gains = chi2.rvs(parameters, size=4000, random_state=0)
    passed = np.mean([trust.is_significant(gain, parameters) for gain in gains])
    assert 0.005 < passed < 0.016  # four standard errors to either side of 0.01, and more
