import json

import numpy as np
import pytest
from PIL import Image

import periscopy_sim as ps

jit = pytest.mark.usefixtures("jit", "few_lights", "few_paths")

TINY = ("demo", "--hidden", "6x7", "--resolution", "24", "--effort", "0.02")
FILES = {
    *("A.npy", "photograph.exr", "reconstruction.npy", "reconstruction.png", "truth.png"),
    *("demo.png", "summary.json"),
}


@pytest.mark.usefixtures("drawings")
@jit
def test_demo_recovers_what_the_monitor_shows(succeeds, tmp_path):
    (tmp_path / "out").mkdir()
    (tmp_path / "out" / "notes.txt").write_text("kept")
    out = succeeds(*TINY, "--seed", "2", "--out", "out")
    folder = tmp_path / "out"
    assert {path.name for path in folder.iterdir()} == FILES | {"notes.txt"}
    for name in FILES:
        assert f"out/{name}" in out
    summary = json.loads((folder / "summary.json").read_text())
    image = np.load(folder / "reconstruction.npy")
    assert image.shape == (6, 7, 3) and image.dtype == np.float32
    assert np.load(folder / "A.npy").shape == (576, 42)
    truth = ps.read_hidden_image(ps.find_image("mushroom"), (6, 7))
    assert summary["psnr"] == pytest.approx(ps.psnr(image, truth), abs=1e-3)
    assert f"PSNR {summary['psnr']:.1f} dB" in out
    # Better than the best flat picture, and than the same upside down.
    assert summary["psnr"] > ps.psnr(np.ones_like(truth), truth) + 2
    assert summary["psnr"] > ps.psnr(image[::-1], truth) + 1
    photograph = ps.read_photograph(folder / "photograph.exr", (24, 24)).values
    assert photograph.mean() == pytest.approx(1, abs=1e-3)
    assert (summary["sbr"], summary["snr"]) == (0.5, 60)
    assert set(summary["seconds"]) >= {"transport matrix", "photograph", "reconstruct"}
    assert summary["provenance"]["seed"] == 2
    for name in ("demo.png", "truth.png", "reconstruction.png"):
        with Image.open(folder / name) as picture:
            picture.load()
            assert "periscopy demo" in picture.text["command"]


@jit
def test_impossible_demo_is_refused(refused, monkeypatch):
    monkeypatch.setattr("periscopy_sim.cli.start.demo.say", lambda _: None)
    assert "25x25" in refused(*TINY, "--hidden", "25x25", "--out", "out")
