import inspect
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


def rounded(photograph, bits):
    return np.round(photograph * 2 ** int(bits)) / 2 ** int(bits)


def cut(photograph, value):
    del value
    return photograph[1:]


@pytest.mark.usefixtures("jit")
def test_an_axis_of_ones_own_changes_photographs_after_their_noise(tmp_path):
    """Also by its file, in workers; a file that has changed is another sweep."""
    file = tmp_path / "camera.py"
    file.write_text(f"import numpy as np\n{inspect.getsource(rounded)}", "utf-8")
    scene = ps.load_scenario("chair", (3, 4), {"resolution": 12})
    signal, asked = scene.photograph("mushroom"), {"sbr": [1], "snr": [40]}
    mask = np.ones((12, 12), bool)
    mask[0] = False
    asked |= {
        "methods": ["truncated-svd"], "ambient": {"lamp": np.ones((12, 12, 3))},
        "photograph": replace(signal, mask=mask),
    }  # fmt: skip
    plain = ps.sweep(scene, ["mushroom"], **asked)
    ways = [
        ps.sweep(scene, ["mushroom"], folder, vary={axis: [2, 40]}, **asked)
        for axis, folder in ((rounded, None), (f"{file}:rounded", tmp_path / "out"))
    ]
    for way in ways:
        np.testing.assert_allclose(way.psnr.sel(rounded=40), plain.psnr, rtol=1e-6)
        assert abs(way.psnr.sel(rounded=2).item() - plain.psnr.item()) > 0.1
    np.testing.assert_allclose(ways[0].psnr, ways[1].psnr, rtol=1e-6)
    file.write_text(f"{file.read_text('utf-8')}\n", "utf-8")
    with pytest.raises(OutputError):
        ps.sweep(scene, ["mushroom"], tmp_path / "out", vary={f"{file}:rounded": [2]}, **asked)


@pytest.mark.usefixtures("jit")
@pytest.mark.parametrize("axis", [cut, "camera.py:cut", lambda photograph: photograph, "m:sbr"])
def test_an_axis_that_is_none_is_an_error(axis, tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    (tmp_path / "m.py").write_text("def sbr(y, value): return y\n", "utf-8")
    scene = ps.load_scenario("chair", (3, 4), {"resolution": 12})
    with pytest.raises(PeriscopyError, match=r"cut|lambda|sbr"):
        ps.sweep(
            scene, ["mushroom"], methods=["truncated-svd"],
            ambient={"lamp": np.ones((12, 12, 3))}, sbr=[1], snr=[40], vary={axis: [1]},
        )  # fmt: skip
