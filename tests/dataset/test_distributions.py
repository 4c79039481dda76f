import numpy as np
import pytest
from pydantic import ValidationError
from scipy import stats

from periscopy_sim.dataset.distributions import Distribution, within
from periscopy_sim.storage.formats.yaml_document import Strict


def draws(drawn, count=4000):
    rng = np.random.default_rng(0)
    return np.array([drawn.draw(rng) for _ in range(count)])


def distribution_of(given):
    return Distribution.model_validate(given)


# Kolmogorov-Smirnov at 1e-4, one seed: each fails for a right distribution once in 10,000 seeds.
@pytest.mark.parametrize(
    ("given", "transform", "distribution"),
    [
        ({"uniform": [2, 5]}, None, stats.uniform(2, 3)),
        ({"log_uniform": [0.1, 10]}, np.log10, stats.uniform(-1, 2)),
        ({"normal": [1, 2]}, None, stats.norm(1, 2)),
    ],
)
def test_draws_follow_the_distribution(given, transform, distribution):
    values = draws(distribution_of(given))
    low, high = distribution_of(given).bounds
    assert low <= values.min() and values.max() <= high
    values = values if transform is None else transform(values)
    assert stats.kstest(values, distribution.cdf).pvalue > 1e-4


def test_every_choice_is_drawn_alike():
    values, counts = np.unique(draws(distribution_of({"choice": [1, 2, 7]})), return_counts=True)
    assert values.tolist() == [1, 2, 7]
    assert stats.chisquare(counts).pvalue > 1e-4


@pytest.mark.parametrize(
    "given",
    [
        {"uniform": [5, 2]}, {"log_uniform": [0, 2]}, {"normal": [0, -1]}, {"choice": []},
        {"uniform": [0, 1], "value": 1}, {}, [1, 2], None, "many", float("nan"),
        {"uniform": [0, float("inf")]}, {"unifrom": [0, 1]},
    ],
)  # fmt: skip
def test_other_entries_are_rejected(given):
    with pytest.raises(ValidationError):
        distribution_of(given)


def test_quantities_that_could_leave_the_range_are_refused():
    class Model(Strict):
        share: within(0, 1)

    assert Model.model_validate({"share": {"uniform": [0, 1]}}).share.bounds == (0, 1)
    for given in (1.5, {"uniform": [0.5, 1.5]}, {"normal": [0.5, 0.1]}, {"choice": [0, -1]}):
        with pytest.raises(ValidationError, match="from 0 to 1"):
            Model.model_validate({"share": given})
