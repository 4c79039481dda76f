import sys

import numpy as np
import pytest

import periscopy_sim as ps
from periscopy_sim.errors import PeriscopyError
from periscopy_sim.reconstruction.learned.weights import SHIPPED, read_weights
from periscopy_sim.reconstruction.registry import METHODS

HIDDEN = 29, 36


@pytest.fixture(scope="module", name="scene")
def coarse():
    return ps.load_scenario("chair", HIDDEN, {"resolution": 48})


def test_without_pytorch_the_method_says_what_to_install(scene, monkeypatch):
    monkeypatch.setitem(sys.modules, "torch", None)
    assert METHODS["unrolled"].needs == "torch"
    with pytest.raises(PeriscopyError, match=r"pip install -e '\.\[torch\]'"):
        METHODS["unrolled"](scene, np.ones((2304, 1044)), np.ones((2304, 1)))


@pytest.mark.torch
def test_shipped_weights_tell_what_they_learned_from():
    pytest.importorskip("safetensors")
    weights = read_weights(SHIPPED)
    assert weights.hidden_shape == HIDDEN
    assert sum(each.numel() for each in weights.tensors.values()) < 1.3e5
    recorded = {"data", "samples_sha256", "photographs", "seed", "training_steps", "torch"}
    assert recorded <= set(weights.provenance) and len(weights.digest) == 64


@pytest.mark.torch
def test_shipped_network_gains_on_a_scene_that_a_ruler_got_wrong(scene):
    pytest.importorskip("safetensors")
    off = {"occluder_dx": 0.004, "occluder_dz": -0.004}
    there = ps.load_scenario("chair", HIDDEN, {"resolution": 48, **off})
    told, B = ps.analytic_transport(scene), ps.point_light_backgrounds(scene)
    A = ps.analytic_transport(there)
    gained = []
    for number, name in enumerate(("still_life", "sunset", "mushroom")):
        truth = ps.read_hidden_image(ps.find_image(name), HIDDEN)
        y = (A @ truth.reshape(-1, 3)).reshape(48, 48, 3)
        photograph = ps.add_noise(y / y.mean(), snr=60, seed=number)
        images = {
            method: METHODS[method](scene, told, B).reconstruct(photograph)
            for method in ("noise-aware", "unrolled")
        }
        assert images["unrolled"].shape == (*HIDDEN, 3) and (images["unrolled"] >= 0).all()
        psnr = {method: ps.registered(image, truth).psnr for method, image in images.items()}
        gained.append(psnr["unrolled"] - psnr["noise-aware"])
    assert np.mean(gained) > 0, gained
    again = METHODS["unrolled"](scene, told, B).reconstruct(photograph)
    assert np.array_equal(again, images["unrolled"])
