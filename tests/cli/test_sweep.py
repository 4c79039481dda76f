import csv
import json
import signal
import subprocess
import sys
from pathlib import Path
from types import SimpleNamespace

import numpy as np
import pytest
import xarray as xr

import periscopy_sim as ps
from periscopy_sim.cli import sweep
from periscopy_sim.cli.light import Light
from periscopy_sim.rendering.transport.plan import TransportPlan
from periscopy_sim.storage.formats.exr import write_exr
from tests.scenes.contents import contents

pytestmark = pytest.mark.usefixtures("few_lights")

OWN_METHODS = """
class Mine:
    def __init__(self, scenario, A, B):
        self.shape, self.A = (*scenario.hidden_shape, 3), A

    def reconstruct(self, photograph):
        return (self.A.T @ photograph.reshape(len(self.A), 3)).reshape(self.shape)

class Failing(Mine):
    def reconstruct(self, photograph):
        raise KeyError("lost")

class Unfit(Mine):
    def __init__(self, scenario, A, B):
        raise KeyError("no")
"""


@pytest.fixture(autouse=True)
def folder(tmp_path):
    """What a sweep needs, in the current folder: a photograph, its truth, ambient light."""
    x, z = np.meshgrid(np.linspace(-1, 1, 21), np.linspace(-1, 1, 21))
    for name, light in {"left": 2 - x, "lamp": 1 / (2 + x**2 + z)}.items():
        write_exr(tmp_path / f"{name}.exr", light[..., None] * [1.0, 0.9, 0.8], {})
    write_exr(tmp_path / "small.exr", np.ones((20, 21, 3)), {})
    rng = np.random.default_rng(31)
    np.save(tmp_path / "truth.npy", rng.uniform(0.1, 1, (4, 5, 3)))
    np.save(tmp_path / "y.npy", rng.uniform(1, 2, (21, 21, 3)))
    (tmp_path / "mine.py").write_text(OWN_METHODS)
    return tmp_path


def command(*more, **changes):
    """Give the arguments of a small sweep, some of its options changed."""
    options = {
        "photograph": "y.npy", "truth": "truth.npy", "ambient": "left.exr,lamp.exr",
        "sbr": "0.5,5", "methods": "preconditioned,truncated-svd", "out": "out", **changes,
    }  # fmt: skip
    listed = [str(part) for name, value in options.items() for part in (f"--{name}", value)]
    scene = ("plate", "-D", "resolution=21", "--hidden", "4x5", "--samples", "4")
    return ("sweep", *scene, *listed, *more)


@pytest.mark.usefixtures("jit", "drawings")
def test_sweep_writes_store_table_and_picture(succeeds, folder):
    methods = "truncated-svd,mine.py:Mine,mine.py:Failing"
    shown = succeeds(*command(methods=methods, seeds=2, snr=45, seed=3))
    out = folder / "out"
    assert {path.name for path in out.iterdir()} == {
        ".lock", "settings.json", "A.npy", "A.json",
        "sweep.zarr", "sweep.csv", "sweep.png",
    }  # fmt: skip
    scenario = ps.load_scenario(ps.find_scene("plate"), (4, 5), {"resolution": "21"})
    A = ps.render_transport(scenario, samples=4, seed=3)
    method = ps.TruncatedSVD(A, hidden=(4, 5), channel_gain=scenario.channel_gain)
    y, truth = np.load("y.npy"), np.load("truth.npy")
    light = ps.read_photograph("lamp.exr", (21, 21)).values
    image = method.reconstruct(
        ps.Sweep(y, truth, {"lamp": light}, {"": method}, [5], 45, seed=3).photograph("lamp", 5, 0)
    )
    with xr.open_dataset(out / "sweep.zarr", engine="zarr", consolidated=False) as results:
        assert list(results["background"].values) == [
            *("left", "left up-down", "left left-right", "left both"),
            *("lamp", "lamp up-down", "lamp left-right", "lamp both"),
        ]
        assert list(results["sbr"].values) == [0.5, 5] and list(results["seed"].values) == [0, 1]
        cell = results.isel(algorithm=0, seed=0).sel(background="lamp", sbr=5)
        assert np.allclose(cell["reconstruction"], image, rtol=1e-4, atol=1e-6)
        assert float(cell["psnr"]) == pytest.approx(ps.psnr_gain_matched(image, truth), abs=1e-3)
        record = results.attrs
    with (out / "sweep.csv").open(newline="") as stream:
        rows = list(csv.DictReader(stream))
    assert len(rows) == 3 * 8 * 2 * 2
    assert {row["failure"] for row in rows if row["algorithm"] == "mine.py:Failing"} == {
        "KeyError: 'lost'"
    }
    made = {(row["model"], row["samples"], float(row["transport_error"]) > 1e-4) for row in rows}
    assert made == {("rendered", "4", True)}
    assert "mine.py:Failing failed on 32 of 32" in shown
    settings = json.loads((out / "settings.json").read_text())
    assert record["settings"] == settings
    assert settings["parameters"] == {"resolution": "21"} and settings["samples"] == 4
    assert {"periscopy-sim", "mitsuba", "numpy", "variant", "scene_sha256"} <= set(settings)
    assert not {"command", "scene"} & set(settings)


@pytest.mark.parametrize(
    ("plan", "file"),
    [((16, 1), "A_16_rays.npy"), ((16, 3), "A.npy"), ((None, 3), "A.npy"), ((8, 1), "A.npy")],
)
def test_only_methods_that_ask_for_rays_have_a_matrix_of_their_own(plan, file, monkeypatch):
    monkeypatch.setattr(sweep, "write_transport", lambda *_: None)
    session = SimpleNamespace(transport=lambda _, matrix: matrix)
    matrix = sweep._transport(session, Light(), TransportPlan(0.0, *plan), Path())
    assert matrix.name == file


@pytest.mark.parametrize(
    ("changes", "offender"),
    [
        ({"hidden-image": "bars"}, "--hidden-image"),
        ({"ambient": "left.exr,./left.exr"}, "--ambient"),
        ({"ambient": "left.exr,small.exr"}, "small.exr"),
        ({"scheduler": "nonsense://x"}, "'nonsense://x'"),
    ],
)
def test_bad_input_is_one_line(changes, offender, refused):
    assert offender in refused(*command(**changes))


KILLED = """
import os, pathlib, signal, sys
from periscopy_sim import cli
from periscopy_sim.analytic import point_light
grid = point_light.paper_grid
point_light.paper_grid = lambda: grid(2.0)
replace, left = pathlib.Path.replace, {writes}

def dies(path, target):
    global left
    left -= 1
    if left == 0:
        os.truncate(path, path.stat().st_size // 2)
        os.kill(os.getpid(), signal.SIGKILL)
    return replace(path, target)

pathlib.Path.replace = dies
sys.argv = ["periscopy", *{arguments!r}]
cli.main()
"""


@pytest.mark.thorough
@pytest.mark.usefixtures("jit")
def test_sweep_killed_twice_ends_in_the_same_bytes(succeeds, folder):
    succeeds(*command(out="whole"))
    # In the midst of the matrix, and among the results.
    for writes in (3, 50):
        code = KILLED.format(writes=writes, arguments=command())
        ended = subprocess.run([sys.executable, "-c", code], cwd=folder, capture_output=True)
        assert ended.returncode == -signal.SIGKILL, ended.stderr
        assert not (folder / "out" / "sweep.csv").exists()
    marks = list((folder / "out/sweep.zarr/making/finished").glob("*.json"))
    assert 0 < len(marks) < 16
    succeeds(*command())
    assert contents(folder / "out") == contents(folder / "whole")


@pytest.mark.usefixtures("jit")
def test_folder_of_another_sweep_is_refused_before_rendering(
    monkeypatch, succeeds, refused, folder
):
    succeeds(*command(methods="mine.py:Mine"))
    np.save(folder / "other.npy", np.load(folder / "y.npy") + 1)
    monkeypatch.setattr(Light, "transport", None)
    for change, key in [
        (("--methods", "preconditioned"), "methods"),
        (("--seed", "1"), "base_seed"),
        (("--photograph", "other.npy"), "photograph"),
        (("--samples", "5"), "samples"),
        (("-D", "occluder_dx=0.001"), "parameters.occluder_dx"),
    ]:
        assert key in refused(*command(*change, methods="mine.py:Mine")), change
    with (folder / "mine.py").open("a") as stream:
        stream.write("\n# changed\n")
    assert "methods" in refused(*command(methods="mine.py:Mine"))


@pytest.mark.usefixtures("jit")
def test_method_that_cannot_be_fitted_is_named_and_can_be_corrected(
    refused, periscopy, succeeds, folder
):
    outcome = periscopy(*command(methods="mine.py:Unfit"))
    assert outcome.code == 2 and "'mine.py:Unfit'" in outcome.err
    assert "samples" in refused(*command("--samples", "5"))
    matrix = (folder / "out" / "A.npy").stat().st_mtime_ns
    # Whatever does not bear upon the matrix may be another.
    succeeds(*command(methods="mine.py:Mine", sbr="2", snr=50, ambient="lamp.exr"))
    assert (folder / "out" / "A.npy").stat().st_mtime_ns == matrix


def test_files_of_unknown_origin_are_not_taken_up(refused, folder):
    (folder / "out").mkdir()
    (folder / "out" / "A.npy").write_text("old")
    assert "A.npy" in refused(*command())
