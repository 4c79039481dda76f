"""`periscopy reconstruct --method noise-aware`."""

import json

import numpy as np
import pytest

import periscopy_sim as ps
from periscopy_sim.reconstruction.noise_aware.noise_aware import NoiseAware

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
    assert "the scene is right" in summary["standard_errors_assume"]
    assert summary["warnings"] == []


DOT = np.zeros((24, 24, 3))
DOT[9, 14] = 1
RAMP = np.linspace(1, 2, 24)[:, None] * np.ones((24, 24, 3))


@pytest.mark.thorough
@pytest.mark.usefixtures("drawings")
@pytest.mark.parametrize("y", [np.ones((24, 24, 3)), RAMP, RAMP.swapaxes(0, 1), DOT])
def test_photograph_that_shows_nothing_is_told(periscopy, tmp_path, y):
    np.save(tmp_path / "y.npy", y)
    outcome = periscopy("reconstruct", "y.npy", *TINY, "--out", "out")
    assert outcome.code == 0 and "hidden image: " in outcome.err
    warnings = json.loads((tmp_path / "out/summary.json").read_text())["warnings"]
    assert any("hidden image" in each for each in warnings)


OWN = """
from periscopy_sim.reconstruction.noise_aware.noise_aware import NoiseAware

class Halved(NoiseAware):
    def reconstruct(self, photograph):
        return super().reconstruct(photograph) / 2

def fit(scenario, A, B):
    return NoiseAware.for_scene(scenario, A, B)

def fit_halved(scenario, A, B):
    return Halved.for_scene(scenario, A, B)
"""


def test_photograph_is_solved_once_for_the_image_and_its_errors(monkeypatch, succeeds, tmp_path):
    solve, photographs = NoiseAware.solve, []

    def counted(method, photograph):
        photographs.append(photograph)
        return solve(method, photograph)

    monkeypatch.setattr(NoiseAware, "solve", counted)
    np.save(tmp_path / "y.npy", np.random.default_rng(0).uniform(1, 2, (24, 24, 3)))
    succeeds("reconstruct", "y.npy", *TINY, "--method", "noise-aware", "--out", "out")
    assert (tmp_path / "out" / "standard_error.npy").is_file()
    assert len(photographs) == 1


def test_errors_are_told_of_the_image_that_is_written_alone(succeeds, tmp_path):
    np.save(tmp_path / "y.npy", np.random.default_rng(0).uniform(1, 2, (24, 24, 3)))
    (tmp_path / "own.py").write_text(OWN)
    for name in ("fit", "fit_halved"):
        succeeds("reconstruct", "y.npy", *TINY, "--method", f"own.py:{name}", "--out", name)
    plain, halved = (np.load(tmp_path / n / "reconstruction.npy") for n in ("fit", "fit_halved"))
    np.testing.assert_allclose(halved, plain / 2, rtol=1e-6)
    assert (tmp_path / "fit" / "standard_error.npy").is_file()
    assert not (tmp_path / "fit_halved" / "standard_error.npy").exists()


def test_gain_over_the_wall_is_told(succeeds, tmp_path):
    scenario = ps.load_scenario("chair", (4, 5), {"resolution": 24})
    hidden = np.random.default_rng(0).uniform(0.1, 1, (20, 3))
    signal = (ps.render_transport(scenario, samples=4) @ hidden).reshape(24, 24, 3)
    gain = 1 + 0.3 * np.linspace(-1, 1, 24)[None, :, None]
    noise = 1e-4 * signal.mean() * np.random.default_rng(1).standard_normal(signal.shape)
    np.save(tmp_path / "y.npy", gain * signal + noise)
    told = succeeds("reconstruct", "y.npy", *TINY, "--method", "noise-aware", "--out", "out")
    summary = json.loads((tmp_path / "out" / "summary.json").read_text())
    assert summary["wall_gain_found"] is True
    (line,) = [line for line in told.splitlines() if "gain" in line]
    assert line.startswith("a smooth gain over the wall: ") and "the image allows for it" in line
    np.testing.assert_allclose(summary["wall_gain_range"], [0.7, 1.3], atol=0.1)


def test_scene_that_is_off_leaves_more_unexplained(succeeds, tmp_path):
    scenario = ps.load_scenario("chair", (4, 5), {"resolution": 24})
    hidden = np.random.default_rng(0).uniform(0.1, 1, (20, 3))
    signal = (ps.render_transport(scenario, samples=4) @ hidden).reshape(24, 24, 3)
    np.save(tmp_path / "y.npy", ps.add_noise(signal, snr=60, seed=0))
    unexplained = {}
    for place in ("0", "0.03"):
        told = succeeds("reconstruct", "y.npy", *TINY, "-D", f"occluder_dx={place}", "--out", place)
        summary = json.loads((tmp_path / place / "summary.json").read_text())
        unexplained[place] = summary["unexplained"]
        assert (
            f"unexplained: {100 * unexplained[place]:.2f} % of the photograph; noise alone would "
            f"leave {100 * summary['noise_alone']:.2f} %"
        ) in told
        causes, warnings = summary["likely_causes"], " ".join(summary["warnings"])
        assert ("likely causes" in warnings) == bool(causes) == (place != "0")
    assert next(iter(causes)) == "geometry" and summary["structured"]
    assert unexplained["0"] < 1.5e-3 and unexplained["0.03"] > 3 * unexplained["0"]
