import numpy as np
from numba.core import caching

from periscopy_sim.numerics.compilation import compiled


def mean(values):
    return values.sum() / values.size


def test_a_read_only_home_costs_the_cache_alone(monkeypatch):
    monkeypatch.setattr(caching.CacheImpl, "_locator_classes", [])
    assert compiled(mean)(np.arange(5.0)) == 2
