import numpy as np
import pytest

from periscopy_sim.calibration.global_search import explore, points_visited


class Valley:
    """Evidence of parameters that are best somewhere in the box, and tied to each other.

    Bumps hide the slope. Values below -0.9 are not physical.
    """

    def __init__(self, seed, parameters=3, bump=0.0):
        self.best = np.random.default_rng(seed).uniform(-0.8, 0.8, parameters)
        self.bump = bump

    def evidence(self, values):
        if min(values) < -0.9:
            return np.inf
        off = values - self.best
        return off @ off + off.sum() ** 2 + self.bump * np.cos(30 * np.pi * off).sum()


def ignore(values, evidence):
    pass


def found(level, seed):
    count = len(level.best)
    return explore(level, np.zeros(count), np.ones(count), seed, ignore)


@pytest.mark.parametrize(
    ("parameters", "bump", "limit"), [(1, 0.0, 0.001), (3, 0.0, 0.02), (3, 0.02, 0.1)]
)
def test_it_ends_within_the_reach_of_slopes(parameters, bump, limit):
    # Slopes are taken over an eighth of the box or less: see `STEP` and `SPREAD`.
    levels = [Valley(seed, parameters, bump) for seed in range(10)]
    errors = [found(level, seed) - level.best for seed, level in enumerate(levels)]
    assert np.abs(errors).max() < limit


def test_the_same_seed_visits_the_same_points():
    level, start = Valley(0), np.array([0.1, 0.2, 0.3])
    visits = [[], [], []]
    for seed, visited in zip((7, 7, 8), visits, strict=True):
        explore(
            level, start, np.ones(3), seed, lambda v, e, visited=visited: visited.append((*v, e))
        )
    assert len(visits[0]) == points_visited(3)
    np.testing.assert_array_equal(visits[0], visits[1])
    assert visits[0][0] == (*start, level.evidence(start))
    assert not np.array_equal(visits[0], visits[2])
