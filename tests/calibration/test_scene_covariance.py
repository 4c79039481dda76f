from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from periscopy_sim.calibration import prior
from periscopy_sim.calibration.calibrated_scene import write_copy
from periscopy_sim.calibration.result import Parameter
from periscopy_sim.errors import SceneError
from periscopy_sim.rendering.scene_files import read_document
from periscopy_sim.scene import CALIBRATED
from periscopy_sim.shipped import find_scene
from tests.scenes.calibration import calibration

CHAIR = read_document(find_scene("chair"))
RNG = np.random.default_rng(0)
ROOT = RNG.standard_normal((3, 3)) * np.array([1e-3, 2e-3, 0.7])[:, None]
KNOWN = prior.SceneCovariance(
    ("occluder_dx", "occluder_dz", "monitor_turn"),
    np.array([0.0012, -0.003, 0.8]),
    ROOT @ ROOT.T,
    trusted=True,
    ruled=np.array([0.0, 0.001, 1.5]),
)


WRITTEN = {n: f"{v:.9g}" for n, v in zip(KNOWN.names, KNOWN.values, strict=True)}


def carrying(tmp_path: Path, text: str, **values: str) -> Path:
    scene = tmp_path / "scene.xml"
    write_copy(CHAIR, {CALIBRATED: text, **values}, scene)
    return scene


@pytest.mark.parametrize("trusted", [True, False])
def test_a_scene_carries_what_was_written(tmp_path: Path, trusted: bool) -> None:
    scene = carrying(tmp_path, replace(KNOWN, trusted=trusted).text())
    again = tmp_path / "again.xml"
    write_copy(read_document(scene), {"occluder_dy": "0.1"}, again)
    for path in (scene, again):
        found = prior.scene_covariance(read_document(path))
        assert found is not None
        assert (found.names, found.trusted) == (KNOWN.names, trusted)
        np.testing.assert_allclose(found.values, KNOWN.values, rtol=1e-8)
        np.testing.assert_allclose(found.ruled, KNOWN.ruled, rtol=1e-8)
        np.testing.assert_allclose(found.covariance, KNOWN.covariance, rtol=1e-4)
    assert prior.scene_covariance(CHAIR) is None


def test_a_second_calibration_begins_where_the_ruler_has_the_numbers(tmp_path: Path) -> None:
    """But for those that are given, or that were changed by hand since."""
    scene = carrying(tmp_path, KNOWN.text(), **{**WRITTEN, "monitor_turn": "0.9"})
    names = ["occluder_dz", "monitor_turn", "occluder_dx", "occluder_dy"]
    given = read_document(scene, {"occluder_dx": "0.0012"})
    np.testing.assert_allclose(prior.ruled_values(given, names), [0.001, 0.9, 0.0012, 0])
    np.testing.assert_array_equal(
        prior.ruled_values(CHAIR, names), prior.start_values(CHAIR, names)
    )


def test_directions_are_a_root_of_the_covariance_without_those_of_no_variance() -> None:
    L = KNOWN.directions
    np.testing.assert_allclose(L @ L.T, KNOWN.covariance, rtol=1e-9)
    twice = replace(KNOWN, covariance=np.outer(ROOT[:, 0], ROOT[:, 0]))
    np.testing.assert_allclose(np.abs(twice.directions), np.abs(ROOT[:, :1]), rtol=1e-9)


def test_values_that_are_set_otherwise_are_named(tmp_path: Path) -> None:
    scene = carrying(tmp_path, KNOWN.text(), **WRITTEN)
    known = prior.scene_covariance(read_document(scene))
    assert known is not None
    same = read_document(scene, {"occluder_dx": "1.2e-3", "resolution": "63"})
    other = read_document(scene, {"occluder_dx": "0.001", "monitor_turn": "a"})
    assert known.changed(same) == []
    assert known.changed(other) == ["occluder_dx", "monitor_turn"]
    assert known.changed(read_document(carrying(tmp_path, KNOWN.text()))) == list(KNOWN.names)


def test_what_a_calibration_held_is_carried_with_what_it_does() -> None:
    known = replace(
        calibration(),
        parameters=(Parameter("dx", 0, 0.1, 1e-3, 5e-3, 1), Parameter("dz", 0, 0.2, 1e-3, 2e-3, 1)),
        uncertain=prior.UncertainParameters(("monitor_dx",), np.zeros(1), np.array([0.005])),
        moves=np.array([[4e-3], [0.0]]),
        correlation=np.array([[1, 0.5], [0.5, 1]]),
    ).scene_covariance
    assert known.names == ("dx", "dz", "monitor_dx")
    expected = np.array([[25, 5, 20], [5, 4, 0], [20, 0, 25]]) * 1e-6
    np.testing.assert_allclose(known.covariance, expected)
    assert known.trusted


@pytest.mark.parametrize(
    "text",
    [
        "",
        "believed; occluder_dx = 0 from 0 +- 1: 1",
        "trusted",
        "trusted; occluder_dx = 0 from 0: 1",
        "trusted; occluder_dx = 0 from 0 +- 0: 1",
        "trusted; occluder_dx = nan from 0 +- 1: 1",
        "trusted; occluder_dx = 0 from 0 +- 1: 0.5",
        "trusted; occluder_dx = 0 from 0 +- 1: 1; occluder_dz = 0 from 0 +- 1: 1",
        "trusted; occluder_dx = 0 from 0 +- 1: 1; occluder_dz = 0 from 0 +- 1: 1.5 1",
        "trusted; occluder_dx = 0 from 0 +- 1: 1; occluder_dz = 0 from 0 +- 1: nan 1",
    ],
)
def test_what_is_damaged_is_refused(tmp_path: Path, text: str) -> None:
    with pytest.raises(SceneError, match=f"'{CALIBRATED}'"):
        prior.scene_covariance(read_document(carrying(tmp_path, text)))
