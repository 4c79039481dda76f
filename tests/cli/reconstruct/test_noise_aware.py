"""`periscopy reconstruct --method noise-aware`."""

import json

import numpy as np
import pytest

import periscopy_sim as ps

pytestmark = pytest.mark.usefixtures("jit", "few_lights")

TINY = ("--scene", "chair", "-D", "resolution=24", "--hidden", "4x5", "--samples", "4")


@pytest.mark.usefixtures("drawings")
def test_image_and_its_standard_errors_are_written(succeeds, tmp_path):
    scenario = ps.load_scenario("chair", (4, 5), {"resolution": 24})
    hidden = np.random.default_rng(0).uniform(0.1, 1, (20, 3))
    signal = (ps.render_transport(scenario, samples=4) @ hidden).reshape(24, 24, 3)
    noise = 1e-3 * signal.mean() * np.random.default_rng(1).standard_normal(signal.shape)
    np.save(tmp_path / "y.npy", signal + noise)
    succeeds("reconstruct", "y.npy", *TINY, "--method", "noise-aware", "--out", "out")
    folder = tmp_path / "out"
    images = {"certainty.png", "reconstruction.npy", "reconstruction.png", "residual.png"}
    names = images | {"standard_error.npy", "summary.json"}
    assert {path.name for path in folder.iterdir()} == names
    image, errors = (np.load(folder / f"{n}.npy") for n in ("reconstruction", "standard_error"))
    assert image.shape == errors.shape == (4, 5, 3) and errors.dtype == np.float32
    assert (image >= 0).all() and (errors > 0).all()
    off = image - hidden.reshape(4, 5, 3)
    assert np.sqrt(np.mean(off**2)) < 0.02
    assert 0.3 < np.sqrt(np.mean((off / errors) ** 2)) < 1.5
    summary = json.loads((folder / "summary.json").read_text())
    assert summary["method"] == "noise-aware" and summary["iterations"] > 0
    assert np.allclose(summary["noise"], 1e-3 * signal.mean(), rtol=0.2)
    assert summary["lambda"] > 0
    assert summary["wall_gain_found"] is False and summary["wall_gain_range"] == [1, 1]
    assert summary["standard_errors_count"] == []
    assert summary["warnings"] == []


def test_true_scene_of_coarse_patches_fits_by_default(succeeds, tmp_path):
    scenario = ps.load_scenario("chair", (9, 11), {"resolution": 32})
    hidden = ps.read_hidden_image(ps.find_image("mushroom"), (9, 11))
    photograph = ps.render_photograph(scenario, hidden, samples=4096)
    np.save(tmp_path / "y.npy", ps.add_noise(photograph, snr=60, seed=0))
    succeeds("reconstruct", "y.npy", *TINY[:3], "resolution=32", "--hidden", "9x11", "--out", "r")
    summary = json.loads((tmp_path / "r" / "summary.json").read_text())
    assert (summary["model"], summary["samples"]) == ("analytic", None)
    assert summary["diagnosis"] == "fits"
    assert ps.psnr(np.load(tmp_path / "r" / "reconstruction.npy"), hidden) > 29


def test_scene_that_is_off_leaves_more_unexplained(succeeds, tmp_path):
    scenario = ps.load_scenario("chair", (4, 5), {"resolution": 24})
    hidden = np.random.default_rng(0).uniform(0.1, 1, (20, 3))
    signal = (ps.render_transport(scenario, samples=4) @ hidden).reshape(24, 24, 3)
    np.save(tmp_path / "y.npy", ps.add_noise(signal, snr=60, seed=0))
    unexplained = {}
    for place in ("0", "0.03"):
        printed = succeeds(
            "reconstruct", "y.npy", *TINY, "-D", f"occluder_dx={place}", "--out", place
        )
        summary = json.loads((tmp_path / place / "summary.json").read_text())
        unexplained[place] = summary["unexplained"]
        assert place != "0" or f"{100 * unexplained[place]:.2f} %" in printed
        fits = place == "0"
        assert (summary["diagnosis"] == "fits") == (not summary["warnings"]) == fits
    assert unexplained["0"] < 1.5e-3 and unexplained["0.03"] > 3 * unexplained["0"]
