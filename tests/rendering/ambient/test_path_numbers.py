"""Numbers of low discrepancy: how they are distributed, all of them and in parts."""

import numpy as np
import pytest
from scipy import stats
from scipy.stats import qmc

from periscopy_sim.rendering.ambient import path_numbers
from periscopy_sim.rendering.ambient.path_numbers import DIMENSIONS, PathNumbers

pytestmark = pytest.mark.usefixtures("jit")

ORIGINS, PARTS = 16, (32, 96)
PATHS = ORIGINS * sum(PARTS)
LATER = 2 * DIMENSIONS + 3


def numbers_of(seed, dimensions, numbers=None):
    """(dimensions, paths)."""
    import mitsuba as mi

    shifted = (numbers or PathNumbers(ORIGINS, PARTS)).shifted(seed)
    return np.stack([np.array(shifted.at(mi.UInt32(k)), float) for k in dimensions])


@pytest.mark.parametrize("dimension", [0, 1, DIMENSIONS - 1, DIMENSIONS, LATER])
def test_every_dimension_fills_its_interval_evenly(dimension):
    (found,) = numbers_of(3, [dimension])
    assert found.shape == (PATHS,) and found.min() >= 0 and found.max() < 1
    # One in each of as many strata: of numbers by chance a third would be empty.
    assert len(np.unique((found * PATHS).astype(int))) == PATHS


@pytest.mark.parametrize("pair", [(0, 1), (2, 3), (DIMENSIONS, DIMENSIONS + 1), (LATER, LATER + 1)])
def test_pairs_fill_their_square_better_than_chance(pair):
    points = numbers_of(5, pair).T
    chance = np.random.default_rng(0).random((PATHS, 2))
    assert qmc.discrepancy(points) < 0.1 * qmc.discrepancy(chance)


def test_paths_of_each_origin_are_even_by_themselves():
    """Each part is ordered by origin."""
    found = numbers_of(1, [0, 1])
    first = found[:, : ORIGINS * PARTS[0]].reshape(2, ORIGINS, PARTS[0])
    for origin in range(ORIGINS):
        for dimension in range(2):
            strata = np.unique((first[dimension, origin] * PARTS[0]).astype(int))
            # Of numbers by chance 20 of 32 are filled, give or take 2.
            assert len(strata) > 27


@pytest.mark.parametrize("dimension", [0, DIMENSIONS + 1])
def test_every_path_has_any_number_as_often(dimension):
    """Of 400 seeds; each of 8 paths by the test of Kolmogorov and Smirnov, all at 1e-4."""
    numbers = PathNumbers(ORIGINS, PARTS)
    found = np.stack([numbers_of(seed, [dimension], numbers)[0, ::256] for seed in range(400)])
    worst = min(stats.kstest(each, "uniform").pvalue for each in found.T)
    assert worst > 1e-4 / found.shape[1]


def test_repeated_dimensions_and_seeds_know_nothing_of_each_other():
    """Correlations of 2,048 numbers are 1 / sqrt(2,048) by chance; six times that in none of 6."""
    found = np.concatenate(
        [numbers_of(7, [0, DIMENSIONS, 2 * DIMENSIONS]), numbers_of(8, [0, DIMENSIONS])]
    )
    correlation = np.corrcoef(found[[0, 1, 2, 4]])
    assert np.abs(correlation - np.eye(4)).max() < 6 / np.sqrt(PATHS)
    assert not np.array_equal(found[0], found[3])


def test_numbers_of_one_path_know_nothing_of_each_other():
    """Over 400 seeds; all of 28 correlations are below 5 deviations but once in 60,000 times."""
    numbers, dimensions = PathNumbers(ORIGINS, PARTS), [0, 1, 2, 5, 31, 32, 33, 64]
    found = np.stack([numbers_of(seed, dimensions, numbers)[:, 1000] for seed in range(400)])
    correlation = np.corrcoef(found.T) - np.eye(len(dimensions))
    assert np.abs(correlation).max() < 5 / np.sqrt(len(found))


@pytest.mark.parametrize(("origins", "parts"), [(1, (1,)), (3, (5, 7)), (180, (16, 48))])
def test_any_number_of_paths_is_served(origins, parts):
    found = numbers_of(0, [0, LATER], PathNumbers(origins, parts))
    count = origins * sum(parts)
    assert found.shape == (2, count)
    assert (found >= 0).all() and (found < 1).all()
    # Later ones are in another order, and none is left out or comes twice.
    assert len(np.unique(found[0])) == len(np.unique(found[1])) == count


def test_same_seed_gives_the_same_numbers(monkeypatch):
    once, again = (numbers_of(4, [0, LATER]) for _ in range(2))
    assert once.tobytes() == again.tobytes()
    monkeypatch.setattr(path_numbers, "SCRAMBLE", 1)
    assert not np.array_equal(numbers_of(4, [0, LATER]), once)
