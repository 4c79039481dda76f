import numpy as np
import pytest

from experiments.design.ranking import agreement


def test_rank_correlation_is_scipys_and_lies_in_its_interval():
    from scipy.stats import spearmanr

    rng = np.random.default_rng(3)
    one = rng.normal(size=20)
    other = one + rng.normal(size=20)
    found = agreement(one, other)
    assert found.correlation == pytest.approx(spearmanr(one, other).statistic)
    assert -1 < found.low < found.correlation < found.high < 1


def test_monotone_quantities_agree_for_certain():
    one = np.arange(12.0)
    assert str(agreement(one, one**3)) == "1.00 (1.00 to 1.00)"
    assert agreement(one, -one).correlation == pytest.approx(-1)


def test_interval_covers_what_is_true():
    """Of pairs without any relation, 0 lies within the interval of 95 % nearly so often."""
    rng = np.random.default_rng(4)
    found = [agreement(*rng.normal(size=(2, 20)), seed=k) for k in range(60)]
    assert np.mean([each.low <= 0 <= each.high for each in found]) > 0.85
