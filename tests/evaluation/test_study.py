from dataclasses import replace

import numpy as np
import pytest

import periscopy_sim as ps
from periscopy_sim.errors import OutputError, PeriscopyError
from periscopy_sim.storage.rasters import write_exr

pytestmark = pytest.mark.usefixtures("quick_light")

pytest.importorskip("xarray")


@pytest.mark.usefixtures("jit")
def test_values_of_an_axis_may_be_whole_numbers():
    """From a command line they are all floats."""
    scene = ps.load_scenario("chair", (3, 4), {"resolution": 12})
    results = ps.sweep(
        scene, ["mushroom"], methods=["truncated-svd"], ambient={"lamp": np.ones((12, 12, 3))},
        sbr=[1], snr=[40], vary={"occluder_dx": (0, 0.02)},
    )  # fmt: skip
    assert results["occluder_dx"].values.tolist() == [0.0, 0.02]
    assert not results["failure"].values.any()


@pytest.mark.usefixtures("jit")
def test_one_name_or_an_array_is_a_list_of_one():
    scene = ps.load_scenario("chair", (3, 4), {"resolution": 12})
    picture, asked = scene.image("mushroom"), {"sbr": 1, "snr": 40}
    ways = [
        ps.sweep(
            scene, images, methods=methods, ambient={"lamp": np.ones((12, 12, 3))},
            vary={"hidden": sizes}, **asked,
        )
        for images, methods, sizes in (
            ("mushroom", "truncated-svd", "3X4"),
            ({"mushroom": picture}, {"truncated-svd": "truncated-svd"}, [(3, 4)]),
        )
    ]  # fmt: skip
    for way in ways:
        assert way["hidden"].values.tolist() == ["3x4"]
    np.testing.assert_allclose(ways[1]["psnr"], ways[0]["psnr"], rtol=1e-4)


@pytest.mark.usefixtures("jit")
def test_what_the_reader_of_a_light_doubts_is_passed_on(tmp_path):
    light = np.full((12, 12, 3), -1e-3)
    light[:3] = 1
    write_exr(tmp_path / "lamp.exr", light, {})
    scene = ps.load_scenario("chair", (3, 4), {"resolution": 12})
    with pytest.warns(RuntimeWarning, match=r"lamp\.exr"):
        ps.sweep(
            scene, ["mushroom"], methods=["truncated-svd"], ambient=[tmp_path / "lamp.exr"],
            sbr=[1], snr=[40],
        )  # fmt: skip


@pytest.mark.usefixtures("jit")
def test_a_given_matrix_is_of_one_scene_and_one_sweep(tmp_path):
    scene = ps.load_scenario("chair", (3, 4), {"resolution": 12})
    given, other = (replace(scene, light=ps.Light(matrix=k * scene.A)) for k in (1, 2))
    asked = {
        "methods": ["truncated-svd"], "ambient": {"lamp": np.ones((12, 12, 3))}, "sbr": [1],
        "snr": [40],
    }  # fmt: skip
    for axis, value in (("occluder_dx", 0.01), ("hidden", "6x8"), ("model", "rendered")):
        with pytest.raises(PeriscopyError, match=axis):
            ps.sweep(given, ["mushroom"], vary={axis: [value]}, **asked)
    results = ps.sweep(given, ["mushroom"], tmp_path, **asked)
    assert results["transport_model"].item() == "file"
    with pytest.raises(OutputError):
        ps.sweep(other, ["mushroom"], tmp_path, **asked)
