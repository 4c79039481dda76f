import json
import shlex

import numpy as np
import pytest
from PIL import Image

import periscopy_sim as ps

jit = pytest.mark.usefixtures("jit", "few_lights", "few_paths")

TINY = ("demo", "--hidden", "6x7", "--resolution", "24", "--effort", "0.02")
METHODS = ("noise-aware", "preconditioned")


@pytest.mark.usefixtures("drawings")
@jit
def test_demo_recovers_what_the_monitor_shows(succeeds, tmp_path):
    out = succeeds(*TINY, "--seed", "2", "--out", "out")
    folder = tmp_path / "out"
    names = {*METHODS, "ambient.exr", "photograph.exr", "demo.png"}
    assert {path.name for path in folder.iterdir()} == names and "out/demo.png" in out
    truth = ps.read_hidden_image(ps.find_image("mushroom"), (6, 7))
    for method in METHODS:
        image = np.load(folder / method / "reconstruction.npy")
        summary = json.loads((folder / method / "summary.json").read_text())
        assert summary["psnr"] == pytest.approx(ps.psnr_gain_matched(image, truth), abs=1e-3)
        assert (
            summary["provenance"]["seed"] == 2 and f"{method:14}  {summary['psnr']:.2f} dB" in out
        )
    # Better than the best flat picture, and than the same upside down.
    image = np.load(folder / "noise-aware" / "reconstruction.npy")
    assert ps.psnr_gain_matched(image, truth) > ps.psnr_gain_matched(np.ones_like(truth), truth) + 2
    assert ps.psnr_gain_matched(image, truth) > ps.psnr_gain_matched(image[::-1], truth) + 1
    photograph = ps.read_photograph(folder / "photograph.exr", (24, 24)).values
    assert photograph.mean() == pytest.approx(1, abs=1e-3)
    with Image.open(folder / "demo.png") as picture:
        picture.load()
        assert "periscopy demo" in picture.text["command"]


def test_no_file_is_overwritten(refused, tmp_path):
    for name in ("measurements.yaml", "truth/scene.xml"):
        file = tmp_path / "mine" / name
        file.parent.mkdir(parents=True)
        file.write_text("my own")
        assert f"mine/{name}" in refused("tutorial", "--out", "mine")
        file.unlink()


@pytest.mark.usefixtures("jit")
def test_command_that_it_begins_with_makes_the_scene(succeeds, tmp_path):
    hint = succeeds("tutorial", "--out", "mine").splitlines()[-1]
    name, *arguments = shlex.split(hint.removeprefix("begin with: "))
    assert name == "periscopy"
    succeeds(*arguments)
    assert (tmp_path / "lab.xml").is_file()
