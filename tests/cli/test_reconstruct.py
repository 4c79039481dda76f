import hashlib
import json
import time

import numpy as np
import pytest
from PIL import Image

import periscopy_sim as ps

pytestmark = pytest.mark.usefixtures("jit", "few_lights")

PAPER = ("--method", "preconditioned")
COUNTS = np.random.default_rng(21).integers(9000, 65536, (24, 24, 3)).astype(np.uint16)
PICTURES = {"reconstruction.png", "residual.png", "stages.png"}
FILES = {"reconstruction.npy", "summary.json"} | PICTURES


def test_folder_holds_image_pictures_and_summary(light, succeeds, tiny, tmp_path):
    np.save(tmp_path / "y.npy", light[0])
    arguments = ("reconstruct", "y.npy", *tiny, *PAPER, "--seed", "3", "--out", "new/out")
    start = time.perf_counter()
    out = succeeds(*arguments)
    folder = tmp_path / "new" / "out"
    assert {path.name for path in folder.iterdir()} == FILES
    assert all(f"new/out/{name}" in out for name in FILES)
    summary = json.loads((folder / "summary.json").read_text())
    expected = {
        "method": "preconditioned",
        "photograph": "y.npy",
        "hidden_shape": [4, 5],
        "model": "rendered",
        "tv_weight": 1.0,
    }
    assert {name: summary[name] for name in expected} == expected
    assert len(summary["noise"]) == len(summary["lambda"]) == 3 and summary["kappa"] > 0
    assert 0 < sum(summary["seconds"].values()) < time.perf_counter() - start
    provenance = summary["provenance"]
    chair = hashlib.sha256(ps.find_scene("chair").read_bytes()).digest()
    assert provenance["scene_sha256"] == hashlib.sha256(chair).hexdigest()
    assert provenance["command"] == "periscopy " + " ".join(arguments).replace(" --out new/out", "")
    assert provenance["seed"] == 3 and provenance["parameters"] == {"resolution": "24"}
    assert {"periscopy-sim", "mitsuba", "numpy", "python", "variant"} <= set(provenance)
    with Image.open(folder / "reconstruction.png") as picture:
        assert picture.text["scene_sha256"] == provenance["scene_sha256"]


def test_impossible_option_is_refused(refused, tiny, tmp_path):
    np.save(tmp_path / "y.npy", COUNTS)
    for options, offender in [
        (("--method", "magic"), "'magic'"),
        (("--method", "unrolled"), "experiments/learned/unrolled.py:Unrolled"),
        (("--tv-weight", "-1"), "'--tv-weight'"),
        ((*PAPER, "--hidden", "24x24"), "chair.xml"),
        (("--uncertain", "occluder_x=1"), "'occluder_dx'"),
        (("--uncertain", "occluder_dx", "--method", "differencing"), "differencing"),
    ]:
        assert offender in refused("reconstruct", "y.npy", *tiny, *options, "--out", "out")
