"""Calibration as it is called: what it leaves as it found it."""

import numpy as np
import pytest
from threadpoolctl import threadpool_info, threadpool_limits

from periscopy_sim.calibration import calibrate as calibration
from periscopy_sim.calibration.calibrated_scene import write_copy
from periscopy_sim.rendering.scene.document import CALIBRATED
from periscopy_sim.shipped import find_scene


@pytest.mark.usefixtures("jit")
def test_linear_algebra_has_one_thread_as_long_as_the_search_lasts(monkeypatch):
    def threads(*_, **__):
        return {pool["num_threads"] for pool in threadpool_info() if pool["user_api"] == "blas"}

    monkeypatch.setattr(calibration, "calibrate_levels", threads)
    y, free = np.random.default_rng(0).random((32, 32, 3)), {"occluder_dx": 0.01}
    with threadpool_limits(2):
        found = calibration.calibrate(y, "chair", (6, 7), free, parameters={"resolution": 32})
        assert (found, threads()) == ({1}, {2})


@pytest.mark.usefixtures("jit")
def test_a_second_calibration_is_the_first_one_again(monkeypatch, tmp_path):
    """Where it begins, what its prior is about, and by how much a number shifts the image."""
    calls = []

    def levels(levels, start, *_, shift, **__):
        calls.append((start, levels[-1].prior.centers, shift.patches))

    monkeypatch.setattr(calibration, "calibrate_levels", levels)
    y, free = np.random.default_rng(0).random((32, 32, 3)), ["monitor_dx", "occluder_dz"]
    text = "trusted; monitor_dx = 0.02 from 0 +- 0.004: 1; occluder_dz = 0.01 from 0 +- 0.002: 0 1"
    found = {"monitor_dx": "0.02", "occluder_dz": "0.01", CALIBRATED: text}
    write_copy(find_scene("chair"), found, tmp_path / "found.xml")
    for scene in ("chair", tmp_path / "found.xml"):
        calibration.calibrate(y, scene, (6, 7), free, parameters={"resolution": 32})
    first, second = calls
    for one, other in zip(first, second, strict=True):
        np.testing.assert_array_equal(one, other)
    assert np.abs(first[2]).max() > 1
