import numpy as np
import pytest
from periscopy_sim.calibration.search.fisher_information import Curvature
from scipy.stats import chi2

from periscopy_sim.calibration.prior import Prior
from periscopy_sim.calibration.trust import bounded, doubts, is_significant, learned

NAMES = ("dx", "dy")
RULER = Prior(np.array([0.0, 1.0]), np.array([0.01, 0.1]))
MIDDLES, SPREADS = RULER.centers, np.array([0.03, 0.3])


def test_values_within_the_rulers_errors_are_not_doubted():
    assert (
        doubts(NAMES, np.array([0.029, 0.71]), MIDDLES, SPREADS, RULER, True, 2.0, 0.1, 0.1) == ()
    )


def test_a_value_beyond_the_rulers_errors_is_named():
    (doubt,) = doubts(NAMES, np.array([0.18, 1.0]), MIDDLES, SPREADS, RULER, True, 2.0, 0.1, 0.1)
    assert "dx ended 18.0 of the ruler's errors" in doubt


def test_where_no_ruler_is_a_value_outside_of_what_was_searched_is_named():
    unknown = Prior(RULER.centers, np.array([np.inf, np.inf]))
    (doubt,) = doubts(NAMES, np.array([0.029, 1.5]), MIDDLES, SPREADS, unknown, True, 2.0, 0.1, 0.1)
    assert "dy ended outside of what was searched, 1 ± 0.3" in doubt
    about = np.array([0.0, 1.25])
    assert not doubts(NAMES, np.array([0.029, 1.5]), about, SPREADS, unknown, True, 2.0, 0.1, 0.1)


def test_a_photograph_that_tells_nothing_is_doubted_unless_it_gains():
    values = RULER.centers
    (doubt,) = doubts(NAMES, values, MIDDLES, SPREADS, RULER, False, 0.3, 0.1, 0.1)
    assert "tells less of the parameters than the ruler" in doubt
    assert doubts(NAMES, values, MIDDLES, SPREADS, RULER, True, 0.3, 0.1, 0.1) == ()
    assert (
        doubts(NAMES, values, MIDDLES, SPREADS, RULER, False, 1.2, 0.1, 0.1) == ()
    )  # it confirms the ruler


def test_what_stays_unexplained_and_is_no_noise_is_doubted():
    (doubt,) = doubts(NAMES, RULER.centers, MIDDLES, SPREADS, RULER, True, 2.0, 0.61, 0.1)
    assert "61 % stay unexplained" in doubt and "near lamp" in doubt


def test_an_image_that_would_shine_negatively_is_doubted():
    (doubt,) = doubts(NAMES, RULER.centers, MIDDLES, SPREADS, RULER, True, 2.0, 0.1, 0.22)
    assert "22 % of the light of the hidden image" in doubt and "near lamp" in doubt


def test_as_many_parameters_are_learned_as_the_photograph_knows_better():
    known = np.diag([1e8, 1e-2])  # errors of 0.1 mm and of 10, beside a ruler's 10 mm and 0.1
    about = Curvature(None, np.zeros(2), known, np.diag(known), np.zeros(2), RULER)
    assert learned(about) == pytest.approx(1, abs=1e-3)
    alike = np.diag(RULER.precision)
    about = Curvature(None, np.zeros(2), alike, np.diag(alike), np.zeros(2), RULER)
    assert learned(about) == pytest.approx(1)


def test_no_value_is_told_to_be_worse_known_than_by_the_ruler():
    found = np.array([[4.0, 1.0, 0.5], [1.0, 0.25, 0.1], [0.5, 0.1, 1.0]])
    told = bounded(found, np.array([1.0, np.inf, 3.0]))
    np.testing.assert_allclose(np.diag(told), [1.0, 0.25, 1.0])
    correlation = [m / np.sqrt(np.outer(np.diag(m), np.diag(m))) for m in (found, told)]
    np.testing.assert_allclose(*correlation)


@pytest.mark.parametrize("parameters", [1, 6])
def test_gains_by_chance_pass_once_in_a_hundred(parameters):
    gains = chi2.rvs(parameters, size=4000, random_state=0)
    passed = np.mean([is_significant(gain, parameters) for gain in gains])
    assert 0.005 < passed < 0.016  # four standard errors to either side of 0.01, and more
