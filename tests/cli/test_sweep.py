"""What `periscopy sweep` writes and prints, and what it refuses."""

import csv
import json

import numpy as np
import pytest
import xarray as xr
from PIL import Image

import periscopy_sim as ps

pytestmark = pytest.mark.usefixtures("few_lights")

FILES = {
    *(".lock", "settings.json", "A.npy", "A.json"),
    *("sweep.zarr", "sweep.csv", "sweep.png", "seconds.csv"),
}


# -- what is written -----------------------------------------------------------------------------


@pytest.mark.usefixtures("drawings")
@pytest.mark.usefixtures("jit")
def test_sweep_writes_store_table_picture_and_prints_the_means(
    succeeds, sweep_input, sweep_command
):
    shown = succeeds(*sweep_command(methods="preconditioned,mine.py:Mine,mine.py:Failing", seeds=2))
    out = sweep_input / "out"
    assert {path.name for path in out.iterdir()} == FILES
    with xr.open_dataset(out / "sweep.zarr", engine="zarr", consolidated=False) as results:
        assert list(results["background"].values) == [
            *("left", "left up-down", "left left-right", "left both"),
            *("lamp", "lamp up-down", "lamp left-right", "lamp both"),
        ]
        assert list(results["sbr"].values) == [0.5, 5] and list(results["seed"].values) == [0, 1]
        errors = results["mean_squared_error"].transpose("algorithm", "sbr", ...).values
        record = results.attrs
    with (out / "sweep.csv").open(newline="") as stream:
        rows = list(csv.DictReader(stream))
    assert len(rows) == 3 * 8 * 2 * 2
    assert {row["failure"] for row in rows if row["algorithm"] == "mine.py:Failing"} == {
        "KeyError: 'lost'"
    }
    lines = [line.split() for line in shown.splitlines()]
    means = errors.reshape(3, 2, -1).mean(axis=2)
    assert ["mean", "squared", "error", "at", "SBR", "0.5", "5"] in lines
    for name, values in zip(("preconditioned", "mine.py:Mine"), means, strict=False):
        assert [name, *(f"{value:.5f}" for value in values)] in lines
    assert ["mine.py:Failing", "failed", "failed"] in lines
    assert "mine.py:Failing failed on 32 of 32, first: KeyError: 'lost'" in shown
    assert all(str(name) in shown for name in ("out/sweep.zarr", "out/sweep.csv", "out/sweep.png"))
    settings = json.loads((out / "settings.json").read_text())
    assert record["settings"] == settings
    assert settings["parameters"] == {"resolution": "21"} and settings["samples"] == 4
    assert {"periscopy-sim", "mitsuba", "numpy", "variant", "scene_sha256"} <= set(settings)
    assert not {"command", "scene"} & set(settings)
    with Image.open(out / "sweep.png") as picture:
        picture.load()
        assert picture.width == pytest.approx(3.5 * 300, abs=2)
        assert picture.text["command"].startswith("periscopy sweep plate")


@pytest.mark.usefixtures("jit", "sweep_input")
def test_errors_are_those_of_the_public_functions(succeeds, sweep_command):
    succeeds(*sweep_command(methods="truncated-svd", flips=None, no_flips=True, snr=45, seed=3))
    scenario = ps.load_scenario(ps.find_scene("plate"), (4, 5), {"resolution": "21"})
    A = ps.render_transport(scenario, samples=4, seed=3)
    method = ps.TruncatedSVD(A, hidden_shape=(4, 5), channel_gain=scenario.channel_gain)
    y, truth = np.load("y.npy"), np.load("truth.npy")
    light = ps.read_photograph("lamp.exr", (21, 21)).values
    whole = ps.Sweep(y, truth, {"lamp": light}, {"": method}, [5], 45, seed=3)
    image = method.reconstruct(whole.photograph("lamp", 5, 0))
    with xr.open_dataset("out/sweep.zarr", engine="zarr", consolidated=False) as results:
        cell = results.isel(algorithm=0, seed=0).sel(background="lamp", sbr=5)
        assert np.allclose(cell["reconstruction"], image, rtol=1e-4, atol=1e-6)
        assert float(cell["psnr"]) == pytest.approx(ps.psnr(image, truth), abs=1e-3)
        assert results.sizes["background"] == 2


# -- what is refused -----------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("changes", "message"),
    [
        ({"hidden_image": "bars"}, "--hidden-image"),
        ({"methods": "magic"}, "'magic'"),
        ({"methods": "mine.py:Other"}, "'Other'"),
        ({"ambient": "left.exr,./left.exr"}, "--ambient has left twice"),
        ({"ambient": "left.exr,small.exr"}, "small.exr"),
        ({"sbr": "1,0"}, "--sbr '1,0'"),
        ({"scheduler": "nonsense://x"}, "'nonsense://x'"),
    ],
)
@pytest.mark.usefixtures("sweep_input")
def test_bad_input_is_one_line(changes, message, refused, sweep_command):
    assert message in refused(*sweep_command(**changes))
