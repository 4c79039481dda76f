"""Calibration as it is called: what it leaves as it found it."""

import numpy as np
import pytest
from threadpoolctl import threadpool_info, threadpool_limits

from periscopy_sim.calibration import calibrate as calibration


@pytest.mark.usefixtures("jit")
def test_linear_algebra_has_one_thread_as_long_as_the_search_lasts(monkeypatch):
    def threads(*_, **__):
        return {pool["num_threads"] for pool in threadpool_info() if pool["user_api"] == "blas"}

    monkeypatch.setattr(calibration, "calibrate_levels", threads)
    y, free = np.random.default_rng(0).random((32, 32, 3)), {"occluder_dx": 0.01}
    with threadpool_limits(2):
        found = calibration.calibrate(y, "chair", (6, 7), free, parameters={"resolution": 32})
        assert (found, threads()) == ({1}, {2})
