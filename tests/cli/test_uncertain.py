import json

import numpy as np
import pytest

import periscopy_sim as ps
from periscopy_sim.calibration.calibrated_scene import write_copy
from periscopy_sim.calibration.prior import SceneCovariance, free_parameters
from periscopy_sim.rendering.scene_files import read_document
from periscopy_sim.scene import CALIBRATED
from periscopy_sim.shipped import find_scene

pytestmark = pytest.mark.usefixtures("jit", "few_lights")

SMALL = ("--hidden", "4x5", "--samples", "16")
CHAIR = ("--scene", "chair", "-D", "resolution=24", *SMALL)
KNOWN = SceneCovariance(
    ("occluder_dx", "occluder_dz"),
    np.array([0.002, 0.0]),
    np.array([[4e-6, 1e-6], [1e-6, 4e-6]]),
    trusted=True,
    ruled=np.zeros(2),
)


@pytest.fixture
def photo(hidden, light, tmp_path):
    """A photograph of a chair 4 mm to the right."""
    scenario = ps.load_scenario("chair", (4, 5), {"resolution": 24, "occluder_dx": 0.004})
    signal = ps.render_transport(scenario, samples=64, seed=3) @ hidden.reshape(20, 3)
    y = ps.add_noise(signal.reshape(24, 24, 3) + light[1] / 50, 60, 0)
    np.save(tmp_path / "y.npy", y)
    return "y.npy"


@pytest.fixture
def calibrated(tmp_path):
    given = {"resolution": "24", "occluder_dx": "0.002", CALIBRATED: KNOWN.text()}
    write_copy(read_document(find_scene("chair")), given, tmp_path / "calibrated.xml")
    return ("--scene", "calibrated.xml", *SMALL)


@pytest.fixture
def run(periscopy, tmp_path):
    """Reconstruct; return the image, its standard errors and the summary."""

    def recovered(*arguments):
        outcome = periscopy("reconstruct", *arguments, "--out", "out")
        assert outcome.code == 0, outcome.err
        out = tmp_path / "out"
        image, errors = (np.load(out / f"{n}.npy") for n in ("reconstruction", "standard_error"))
        return image, errors, json.loads((out / "summary.json").read_text())

    return recovered


def test_declared_errors_count_by_default(run, photo):
    _, errors, summary = run(photo, *CHAIR)
    _, narrower, _ = run(photo, *CHAIR, "--uncertain", "occluder_dx")
    declared = free_parameters(read_document(find_scene("chair")))
    assert summary["standard_errors_count"] == list(declared)
    assert (errors >= narrower).all()
    assert max(summary["place_standard_error"]) > 0


def test_a_calibrated_scene_widens_the_standard_errors_by_itself(run, photo, calibrated):
    image, errors, summary = run(photo, *calibrated)
    plain, narrower, before = run(photo, *calibrated, "--uncertain", "none")
    np.testing.assert_array_equal(image, plain)
    assert (errors >= narrower).all() and errors.mean() > 1.05 * narrower.mean()
    assert "occluder_dx" in summary["standard_errors_count"]
    assert before["standard_errors_count"] == []
    assert not any("calibration" in each for each in summary["warnings"])


def test_what_is_set_otherwise_is_not_as_it_was_calibrated(run, photo, calibrated):
    _, errors, summary = run(photo, *calibrated, "-D", "occluder_dx=0.004")
    assert summary["standard_errors_count"] == []
    assert any("occluder_dx" in each for each in summary["warnings"])
    assert np.isfinite(errors).all()
