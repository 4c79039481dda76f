import numpy as np

from benchmarks.scoring import interval


def test_intervals_count_geometries_not_cells():
    groups = np.repeat(np.arange(6), 20)
    values = np.random.default_rng(0).normal(size=6)[groups]  # cells tell nothing beyond theirs
    mean, low, high = interval(values, list(groups))
    assert low < mean < high
    assert high - low > 3 * 2 * 1.96 * values.std() / np.sqrt(values.size) / 2
    assert interval(values, list(groups)) == (mean, low, high)


def test_an_interval_covers_the_mean_that_it_estimates():
    rng = np.random.default_rng(5)
    groups = list(np.repeat(np.arange(20), 4))
    hits = 0
    for _ in range(40):
        values = np.repeat(rng.normal(size=20), 4) + rng.normal(size=80)
        _, low, high = interval(values, groups)
        hits += low <= 0 <= high
    assert hits >= 34
