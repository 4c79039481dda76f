"""benchopt runs the unchanged folder; it renders for a minute."""

import numpy as np
import pytest

pytest.importorskip("benchopt")

from benchmarks.running import read_rows, run_suite
from periscopy_sim.errors import PeriscopyError


@pytest.mark.slow
@pytest.mark.filterwarnings("ignore")  # benchopt's and joblib's own
def test_rows_of_one_method_join_those_of_others(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)  # ambient light is kept there
    run_suite("video", ["least-squares"], tmp_path)
    run_suite("video", ["preconditioned"], tmp_path)
    rows = read_rows(tmp_path)
    assert set(rows.label) == {"least-squares", "preconditioned"}
    assert len(rows) == 2 * 2 * 10
    assert np.isfinite(rows.psnr).all()
    assert not rows.failure.any()


def test_a_folder_without_results_is_told(tmp_path):
    with pytest.raises(PeriscopyError, match="run a suite first"):
        read_rows(tmp_path)
