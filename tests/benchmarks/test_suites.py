import dataclasses
import json

import pytest

from benchmarks import freezing, suites
from benchmarks.suites import SUITES
from periscopy_sim.errors import PeriscopyError


def test_the_suites_are_those_that_were_frozen():
    freezing.check_frozen()


def test_metrics_are_those_that_were_frozen():
    assert freezing.metric_example() == pytest.approx(freezing.recorded()["metrics"], rel=1e-6)


@pytest.mark.parametrize(
    "suite",
    [
        pytest.param(name, marks=pytest.mark.thorough if name == "still" else pytest.mark.slow)
        for name in SUITES
    ],
)
def test_photographs_are_those_that_were_frozen(suite, tmp_path_factory):
    held = freezing.recorded()["photographs"][suite]
    rendered = tmp_path_factory.getbasetemp() / "ambient"
    assert freezing.photograph_sums(suite, rendered) == pytest.approx(held, rel=freezing.TOLERANCE)


@pytest.mark.parametrize(
    "change",
    [
        {"seed": 99},
        {"ratios": (0.6,)},
        {"images": ("mushroom",)},
        {"errors": {"occluder_dx": 0.001}},
        {"lights": ("corridor",)},
    ],
)
def test_a_change_without_a_version_is_refused(monkeypatch, change):
    first, *rest = suites._ALL
    monkeypatch.setattr(suites, "_ALL", (dataclasses.replace(first, **change), *rest))
    with pytest.raises(PeriscopyError, match="raise VERSION in benchmarks"):
        freezing.check_frozen()


@pytest.mark.parametrize(
    ("changed", "message"), [({"digest": "another"}, "have changed"), ({}, "is frozen")]
)
def test_a_frozen_version_is_never_written_over(monkeypatch, tmp_path, changed, message):
    record = {**freezing.recorded(), **changed}
    file = tmp_path / "frozen.json"
    file.write_text(json.dumps(record))
    monkeypatch.setattr(freezing, "FROZEN", file)
    with pytest.raises(PeriscopyError, match=message):
        freezing.freeze(tmp_path)
    assert json.loads(file.read_text()) == record
