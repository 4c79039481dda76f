import numpy as np

from benchmarks.scoring import interval


def test_an_interval_covers_the_mean_that_it_estimates():
    rng = np.random.default_rng(5)
    groups = list(np.repeat(np.arange(20), 4))
    hits = 0
    for _ in range(40):
        values = np.repeat(rng.normal(size=20), 4) + rng.normal(size=80)
        _, low, high = interval(values, groups)
        hits += low <= 0 <= high
    assert hits >= 34
