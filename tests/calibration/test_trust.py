"""When a calibration is doubted."""

from __future__ import annotations

from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest
from scipy.stats import chi2

from periscopy_sim.calibration.level import Look
from periscopy_sim.calibration.result import LEARNED
from periscopy_sim.calibration.trust import MISFIT, doubts, is_significant, learned

NAMES = ("dx", "dy")


def look(information: Any = None, unexplained: float = 0.1) -> Look:
    """Return a look at two parameters whose prior has a unit error."""
    nothing = np.zeros(2)
    information = np.eye(2) if information is None else information
    explanation: Any = SimpleNamespace(unexplained=unexplained)
    return Look(nothing, (explanation,), 0.0, 0.0, nothing, nothing, information, np.ones(2))


def test_what_nothing_speaks_against_is_not_doubted() -> None:
    assert doubts(NAMES, np.array([2.9, -2.9]), 1.0, look()) == ()


@pytest.mark.parametrize(
    ("distances", "known", "unexplained"),
    [
        ([18.0, 0.0], 1.0, 0.1),
        ([0.0, 0.0], 0.9 * LEARNED, 0.1),
        ([0.0, 0.0], 1.0, 1.1 * MISFIT),
    ],
)
def test_each_reason_is_a_doubt(distances: list[float], known: float, unexplained: float) -> None:
    (doubt,) = doubts(NAMES, np.array(distances), known, look(unexplained=unexplained))
    assert ("dx" in doubt) == (distances[0] > 0) and "dy" not in doubt


def test_as_many_parameters_are_learned_as_photographs_determine() -> None:
    assert learned(look(np.diag([1e4, 1e-4])), 2) == pytest.approx(1, abs=1e-3)
    assert learned(look(), 2) == pytest.approx(1)
    together = 1e6 * np.ones((2, 2))  # their sum alone
    assert learned(look(together), 2) == pytest.approx(1, abs=1e-3)


@pytest.mark.parametrize("parameters", [1, 6])
def test_gains_by_chance_pass_once_in_a_hundred(parameters: int) -> None:
    gains = chi2.rvs(parameters, size=4000, random_state=0)
    passed = np.mean([is_significant(gain, parameters) for gain in gains])
    assert 0.005 < passed < 0.016  # four standard errors to either side of 0.01, and more
