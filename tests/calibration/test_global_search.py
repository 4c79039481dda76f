import numpy as np
import pytest

from periscopy_sim.calibration.global_search import GENERATIONS, explore, population
from tests.calibration.conftest import TRUTH

START, SPREADS = np.array([0.25, 0.6]), np.array([0.4, 0.5])


def ignore(values, evidence):
    pass


@pytest.mark.parametrize("seed", range(3))
def test_it_comes_near_the_truth_through_bumps_and_past_what_is_not_physical(slat_level, seed):
    level = slat_level(noise=1e-3, seed=seed, bump=50.0)
    found = explore(level, START, SPREADS, seed, ignore)
    np.testing.assert_allclose(found, TRUTH, atol=0.05)


def test_the_same_seed_visits_the_same_points(slat_level):
    level = slat_level(noise=0.01, seed=0)
    visits = [[], [], []]
    for seed, visited in zip((7, 7, 8), visits, strict=True):
        explore(level, START, SPREADS, seed, lambda v, e, visited=visited: visited.append((*v, e)))
    first, later = population(2)
    assert len(visits[0]) == first + GENERATIONS * later
    np.testing.assert_array_equal(visits[0], visits[1])
    assert visits[0][0] == (*START, level.evidence(START))
    assert not np.array_equal(visits[0], visits[2])


def test_one_parameter_is_enough(slat_level):
    level = slat_level(noise=0.01, seed=1)
    line = slat_level(noise=0.01, seed=1)
    line.evidence = lambda values: level.evidence(np.array([values[0], TRUTH[1]]))
    found = explore(line, START[:1], SPREADS[:1], 0, ignore)
    assert found == pytest.approx(TRUTH[:1], abs=0.02)
