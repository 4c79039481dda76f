import numpy as np
import pytest
from periscopy_sim.calibration.search.global_search import explore, first_generation, points_visited


class Valley:
    """Evidence of parameters that are best somewhere in the box, and tied to each other.

    Bumps hide the slope. What is below -0.9 of a half width is not physical.
    """

    def __init__(self, seed, parameters=3, bump=0.0):
        self.best = np.random.default_rng(seed).uniform(-0.8, 0.8, parameters)
        self.start = np.linspace(1, 2, parameters)
        self.spreads = np.geomspace(0.01, 10, parameters)
        self.bump = bump

    def part(self, values):
        """Where values lie in the box, from -1 to 1."""
        return (values - self.start) / self.spreads

    def evidence(self, values):
        if min(self.part(values)) < -0.9:
            return np.inf
        off = self.part(values) - self.best
        return off @ off + off.sum() ** 2 + self.bump * np.cos(30 * np.pi * off).sum()


def ignore(values, evidence):
    pass


@pytest.mark.parametrize(
    ("parameters", "bump", "limit"),
    [(1, 0.0, 0.001), (3, 0.0, 0.03), (3, 0.02, 0.1), (6, 0.0, 0.15)],
)
def test_it_ends_within_the_reach_of_slopes(parameters, bump, limit):
    # Slopes are taken over an eighth of the box or less: see `STEP` and `SPREAD`.
    errors = []
    for seed in range(10):
        level = Valley(seed, parameters, bump)
        found = explore(level, level.start, level.spreads, seed, ignore)
        errors.append(level.part(found) - level.best)
    assert np.abs(errors).max() < limit


def visited(level, seed):
    points = []
    explore(level, level.start, level.spreads, seed, lambda v, e: points.append((*v, e)))
    return points


def test_the_same_seed_visits_the_same_points():
    level = Valley(0)
    one, same, other = (visited(level, seed) for seed in (7, 7, 8))
    np.testing.assert_array_equal(one, same)
    assert not np.array_equal(one, other)
    assert one[0] == (*level.start, level.evidence(level.start))


@pytest.mark.parametrize("parameters", [3, 4])
def test_the_first_points_fill_the_box_evenly(parameters):
    level = Valley(0, parameters)
    points = np.array(visited(level, 0))[:, :-1]
    assert len(points) == points_visited(parameters)
    first = level.part(points[1 : first_generation(parameters)])
    counts = [np.histogram(column, 8, (-1, 1))[0] for column in first.T]
    # All are within, as many in each eighth but for the one that the start takes the place of.
    assert np.sum(counts) == first.size and np.ptp(counts) <= 1
    assert len(first) + 1 == (128 if parameters == 3 else 256)
