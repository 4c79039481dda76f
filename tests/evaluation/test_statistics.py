import numpy as np
import pytest

from periscopy_sim.errors import PeriscopyError
from periscopy_sim.evaluation.statistics import counted, differences, interval

xr = pytest.importorskip("xarray")


def sweep(seed, pictures=8, draws=5, between=1.0, within=0.5, repeats=1):
    """A metric of two methods: pictures and draws vary, the second method is better by 0.7."""
    rng = np.random.default_rng(seed)
    values = rng.normal(0, between, (repeats, 1, pictures, 1))
    values = values + rng.normal(0, within, (repeats, 2, pictures, draws))
    values += np.array([0, 0.7])[:, None, None]
    labels = {"algorithm": ["a", "b"], "image": range(pictures), "seed": range(draws)}
    metric = xr.DataArray(values, labels, ["repeat", *labels])
    metric = metric.squeeze("repeat") if repeats == 1 else metric
    return xr.Dataset({"psnr": metric, "failure": xr.full_like(metric, "", dtype=object)})


def test_intervals_hold_the_truth_as_often_as_they_say():
    """95 % of 8,000: the count's standard deviation is 19.5; 4.5 of them, 7e-6 of error."""
    results = sweep(1, pictures=4, repeats=8000)
    for each in (results, differences(results, ["psnr"], "a")):
        found = interval(each["psnr"].sel(algorithm="b"))
        assert abs(int((abs(found["mean"] - 0.7) <= found["half"]).sum()) - 7600) < 88


@pytest.mark.parametrize("rulers", [2, 4])
def test_intervals_over_rulers_and_places_count_the_spread_of_both(rulers):
    rng = np.random.default_rng(5)
    values = rng.normal(0, 1, (2000, rulers, 1)) + rng.normal(0, 0.6, (2000, 1, 8))
    values = values + rng.normal(0, 0.3, (2000, rulers, 8))
    found = interval(xr.DataArray(values, dims=["repeat", "ruler", "place"]).rename(place="image"))
    held = int((abs(found["mean"]) <= found["half"]).sum())
    assert held >= 1855  # at least 95 %, within 4.5 standard deviations: 7e-6 of error
    assert counted([found.isel(repeat=0)]) == f"8 pictures, {rulers} rulers"


def test_pairing_removes_what_pictures_share():
    results = sweep(2, pictures=20, between=5.0, within=0.1)
    paired = interval(differences(results, ["psnr"], "a")["psnr"])
    assert paired["algorithm"].values.tolist() == ["b"]
    assert float(paired["half"][0]) < 0.1 * float(interval(results["psnr"])["half"][1])
    assert int(paired["pictures"][0]) == 20


def test_failures_are_counted_and_a_single_sample_has_no_interval():
    results = sweep(3)
    results["psnr"][0, 2], results["failure"][0, 2] = np.nan, "lost"
    found = interval(results["psnr"], (), results["failure"])
    assert found["failed"].values.tolist() == [5, 0]
    assert found["pictures"].values.tolist() == [7, 8]
    compared = differences(results, ["psnr"], "a")  # b's have nothing to compare with
    assert interval(compared["psnr"], (), compared["failure"])["failed"].values.tolist() == [5]
    alone = interval(results["psnr"].isel(image=[0], seed=[0]))
    assert np.isnan(alone["half"]).all() and counted([alone]) == "1"


@pytest.mark.parametrize("reference", [("c",), ("1", "sbr"), ("3", "image")])
def test_reference_that_is_not_there_is_named(reference):
    with pytest.raises(PeriscopyError, match=reference[-1]):
        differences(sweep(4), ["psnr"], *reference)
