import hashlib
import json

import numpy as np
import pytest

from periscopy_sim.shipped import find_scene

pytestmark = pytest.mark.usefixtures("jit")

TINY = ("-D", "resolution=24", "--hidden", "4x5", "--samples", "4")


def test_matrix_is_written_with_a_record_beside_it(succeeds, tmp_path):
    out = succeeds("transport", "chair", *TINY, "--seed", "7", "--out", "deep/A.npy")
    assert "deep/A.npy" in out and "deep/A.json" in out
    assert {path.name for path in (tmp_path / "deep").iterdir()} == {"A.npy", "A.json"}
    A = np.load(tmp_path / "deep" / "A.npy")
    assert A.shape == (576, 20) and A.dtype == np.float32
    assert np.isfinite(A).all() and (A >= 0).all() and (A.max(axis=0) > 0).all()
    record = json.loads((tmp_path / "deep" / "A.json").read_text())
    chair = hashlib.sha256(find_scene("chair").read_bytes()).digest()
    assert record["scene_sha256"] == hashlib.sha256(chair).hexdigest()
    assert record["photograph_shape"] == [24, 24] and record["hidden_shape"] == [4, 5]
    assert (record["model"], record["samples"], record["seed"]) == ("rendered", 4, 7)
    assert record["parameters"] == {"resolution": "24"}
    assert record["variant"].endswith("_rgb") and record["mitsuba"] and record["periscopy-sim"]
    command = "periscopy transport chair -D resolution=24 --hidden 4x5 --samples 4 --seed 7"
    assert record["command"] == command  # wherever it lies
