"""The whole experiment in small: it goes on where it stopped, and writes what it found."""

import csv
import json

import numpy as np
import pytest

from experiments.design import __main__ as experiment
from experiments.design import masks
from experiments.design.trial import Stage


@pytest.fixture
def stage(monkeypatch):
    stage = Stage((4, 5), 20, ("bars", "letters"), ("overcast",), bounces=1)

    def even(places, scenario, *_):
        return {place: np.ones((*scenario.photograph_shape, 3)) for place in places}

    monkeypatch.setattr(experiment, "ambient_photographs", even)
    monkeypatch.setattr("experiments.design.trial.RAYS", (4, 1))
    monkeypatch.setattr("experiments.design.trial.ROUGH_RAYS", (2, 1))
    return stage


def test_occluders_are_ranked_by_the_bound_and_kept(stage, tmp_path, monkeypatch):
    tried = [
        masks.Candidate("random", f"four_{k}", masks.flat_mesh(masks.random_mask(4, k)))
        for k in range(3)
    ]
    found = experiment.run(tmp_path, stage, tried)
    held = experiment.report(tmp_path, found, stage)
    assert found[0].errors.shape == (3, 2, 1)
    with (tmp_path / "masks.csv").open(encoding="utf-8") as file:
        rows = list(csv.DictReader(file))
    bounds = [float(row["bound_percent"]) for row in rows]
    assert bounds == sorted(bounds)
    assert {row["name"] for row in rows} == {each.name for each in tried}
    record = json.loads((tmp_path / "design.json").read_text("utf-8"))
    told = record["rank_correlation"]["the bound and the error, noise-aware"]
    assert told["spearman"] == held["the bound and the error, noise-aware"].correlation
    assert (tmp_path / "design.png").is_file()
    monkeypatch.setattr(experiment, "carried_out", None)  # all is kept
    again = experiment.run(tmp_path, stage, tried)
    assert [each.bound for each in again] == [each.bound for each in found]
