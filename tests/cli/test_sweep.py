import csv
import json
import re
import shutil
import signal
import subprocess
import sys
from pathlib import Path
from types import SimpleNamespace

import numpy as np
import pytest
import xarray as xr
from PIL import Image

import periscopy_sim as ps
from periscopy_sim.calibration.prior import free_parameters
from periscopy_sim.evaluation.sweep import World
from periscopy_sim.evaluation.sweep_store import read_sweep
from periscopy_sim.rendering import transport as planning
from periscopy_sim.rendering.scene_files import read_document
from periscopy_sim.storage.rasters import read_exr, write_exr
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
        "sbr": "0.5,5", "methods": "preconditioned,truncated-svd", "samples": "16", "out": "out",
        **changes,
    }  # fmt: skip
    listed = [str(part) for name, value in options.items() for part in (f"--{name}", value)]
    scene = ("plate", "-D", "resolution=21", "--hidden", "4x5")
    return ("sweep", *scene, *listed, *more)


@pytest.fixture(scope="module")
def shelf(tmp_path_factory):
    """Return a folder for the sweep that tests share."""
    return tmp_path_factory.mktemp("shelf") / "out"


BOTH = "truncated-svd,mine.py:Mine"


@pytest.fixture
def finished(jit, shelf, succeeds, folder):  # noqa: ARG001
    """A sweep by both methods, made once, in `out`."""
    if not shelf.exists():
        succeeds(*command(methods=BOTH))
        shutil.copytree(folder / "out", shelf)
    else:
        shutil.copytree(shelf, folder / "out")


@pytest.mark.usefixtures("jit")
def test_sweep_writes_store_table_and_picture(succeeds, folder):
    methods = "truncated-svd,mine.py:Mine,mine.py:Failing"
    given = {"ambient": "lamp.exr", "seeds": 2, "snr": 45, "seed": 3}
    shown = succeeds(*command("--flips", methods=methods, **given))
    out = folder / "out"
    assert {path.name for path in out.iterdir()} == {
        ".lock", "settings.json", "sweep.zarr", "sweep.csv", "sweep.png",
    }  # fmt: skip
    scenario = ps.load_scenario(ps.find_scene("plate"), (4, 5), {"resolution": "21"})
    A = ps.render_transport(scenario, samples=16, seed=3)
    method = ps.TruncatedSVD(A, hidden=(4, 5), channel_gain=scenario.channel_gain)
    y, truth = np.load("y.npy"), np.load("truth.npy")
    light = ps.read_photograph("lamp.exr", (21, 21)).values
    world = World({"truth": y}, {"truth": truth}, {"lamp": light}, {"": method})
    image = method.reconstruct(world.photograph("truth", "lamp", 5, 45, 0, base=3))
    with xr.open_dataset(out / "sweep.zarr", engine="zarr", consolidated=False) as results:
        flips = ["lamp", "lamp up-down", "lamp left-right", "lamp both"]
        assert list(results["background"].values) == flips
        assert list(results["sbr"].values) == [0.5, 5] and list(results["seed"].values) == [0, 1]
        cell = results.squeeze().isel(algorithm=0, seed=0).sel(background="lamp", sbr=5)
        assert np.allclose(cell["reconstruction"], image, rtol=1e-4, atol=1e-6)
        assert float(cell["psnr"]) == pytest.approx(ps.psnr_gain_matched(image, truth), abs=1e-3)
        record = results.attrs
    with (out / "sweep.csv").open(newline="") as stream:
        rows = list(csv.DictReader(stream))
    assert len(rows) == 3 * 4 * 2 * 2
    (failure,) = {row["failure"] for row in rows if row["algorithm"] == "mine.py:Failing"}
    assert "mine.py:Failing" in failure and "KeyError: 'lost' (mine.py:11)" in failure
    made = {(row["model"], row["samples"], float(row["transport_error"]) > 1e-4) for row in rows}
    assert made == {("rendered", "16", True)}
    assert "mine.py:Failing failed on 16 of 16" in shown
    settings = json.loads((out / "settings.json").read_text())
    assert record["settings"] == settings
    assert settings["parameters"] == {"resolution": "21"} and settings["samples"] == 16
    assert {"periscopy-sim", "mitsuba", "numpy", "variant", "scene_sha256"} <= set(settings)
    assert not {"command", "scene"} & set(settings)


@pytest.mark.usefixtures("jit")
def test_axes_vary_in_the_scene_and_in_the_methods_and_each_part_is_rendered_once(
    succeeds, monkeypatch
):
    rendered, render = [], planning.render_transport

    def counted(scenario, *, samples, **options):
        rendered.append((*scenario.parameters.items(), samples))
        return render(scenario, samples=samples, **options)

    monkeypatch.setattr(planning, "render_transport", counted)
    study = (
        "sweep", "plate", "-D", "resolution=21", "--hidden", "4x5", "--hidden-image",
        "bars", "--vary", "occluder_dx=0,0.01", "--vary", "assumed.monitor_dx=0:0.01:2",
        "--vary", "samples=4,8", "--vary", "truncated-svd.tv_weight=0.1,1", "--sbr", "1",
        "--ambient", "left.exr", "--no-flips", "--methods", "truncated-svd", "--out", "out",
    )  # fmt: skip
    succeeds(*study, "--vary", "snr=40,60")
    places = "occluder_dx=0", "occluder_dx=0.01"
    assert len({*rendered}) == 2 * 2 * 2 >= len(rendered) - 1  # one twice, which is timed
    assert {*Path("out").rglob("*.exr")} == {
        Path("out", place, f"photograph_bars_{snr}dB.exr") for place in places for snr in (40, 60)
    }
    with xr.open_dataset("out/sweep.zarr", engine="zarr", consolidated=False) as results:
        psnr = results.psnr.squeeze()
        assert results.occluder_dx.attrs["units"] == "m" and dict(psnr.sizes) == {
            "occluder_dx": 2, "assumed.monitor_dx": 2, "samples": 2, "truncated-svd.tv_weight": 2,
            "snr": 2,
        }  # fmt: skip
        wrong = psnr.sel({"samples": 8, "assumed.monitor_dx": 0.01})
        assert (psnr.sel({"samples": 8, "assumed.monitor_dx": 0.0}) - wrong).mean() > 0
        assert psnr.std("truncated-svd.tv_weight").min() > 0


@pytest.mark.usefixtures("jit")
def test_a_sweep_says_beforehand_what_it_does_and_a_resumed_one_what_is_missing(succeeds):
    options = {"ambient": "left.exr", "methods": "truncated-svd", "snr": "40:60:2"}
    given = command("--flips", **options)
    shown = succeeds(*given)
    assert shown.startswith(
        "16 results: 1 method x 1 image x 2 SBRs x 2 SNRs x 4 flips\nto make: 1 matrix\nabout "
    )
    grown = command("--flips", sbr="0.5,5,50", **options)
    more = json.loads(succeeds(*grown, "--json"))
    assert (more["missing"], more["results"]) == (8, 24) and more["estimated_seconds"] >= 0
    assert "results:" not in succeeds(*grown) and succeeds(*grown, "-q") == ""


@pytest.mark.usefixtures("jit")
def test_a_cell_has_one_photograph_and_a_whatever_ran_before(succeeds):
    """With other SNRs before, a sweep's numbers are those of one in an empty folder."""
    study = (
        "sweep", "plate", "-D", "resolution=21", "--hidden", "4x5", "--hidden-image", "bars",
        "--ambient", "left.exr", "--sbr", "1", "--methods", "mine.py:Mine",
    )  # fmt: skip
    succeeds(*study, "--snr=30", "--out", "resumed")
    for out in ("resumed", "fresh"):
        succeeds(*study, "--snr", "30,65", "--out", out)
    resumed, fresh = (Path(out, "sweep.csv").read_text("utf-8") for out in ("resumed", "fresh"))
    assert sorted(resumed.splitlines()) == sorted(fresh.splitlines())


@pytest.mark.usefixtures("finished")
def test_plot_draws_what_the_last_sweep_asked_for_and_says_what_else_there_is(succeeds, refused):
    def rows(*more):
        succeeds("plot", "out", *more, "--out", "t.csv")
        return len(Path("t.csv").read_text("utf-8").splitlines()) - 1

    assert rows() == 4
    succeeds(*command(sbr="5", methods="mine.py:Mine"))
    said = succeeds("plot", "out", "--out", "p.png")
    assert "algorithm, sbr" in said and rows() == 1
    assert rows("--at", "sbr=0.5,5") == 2 and rows("--at", "algorithm=truncated-svd") == 1
    assert rows("--reference", "truncated-svd") == 1
    dark = command(ambient="none", methods="mine.py:Mine")
    succeeds(*(each for each in dark if each not in ("--sbr", "0.5,5")))
    succeeds(*command(sbr="5", methods="mine.py:Mine"))
    for at in ("background=none", "sbr=inf"):
        assert "missing" not in succeeds("plot", "out", "--at", at, "--out", "t.csv")
        assert rows("--at", at) == 1
    for chunks in Path("out/sweep.zarr").glob("*/c"):
        if chunks.parent.name in ("mean_squared_error", "failure"):
            shutil.rmtree(chunks)  # as before the first result
    assert "no result yet" in refused("plot", "out", "--out", "p.png")
    assert "holds no sweep" in refused("plot", "out/sweep.zarr/making", "--out", "p.png")


@pytest.mark.usefixtures("jit")
def test_a_study_file_says_the_same_and_the_command_line_comes_first(succeeds, refused, folder):
    study = {
        "scene": "plate", "define": {"resolution": 21}, "hidden": "4x5", "samples": 16,
        "photograph": "y.npy", "truth": ["truth.npy"], "ambient": ["left.exr", "lamp.exr"],
        "flips": False, "sbr": "0.5:5:log:2", "methods": ["truncated-svd"], "out": "file",
        "vary": {"truncated-svd.tv_weight": "1:9:2", "snr": 50}, "seeds": 2,
    }  # fmt: skip
    (folder / "study.yaml").write_text(json.dumps(study))
    succeeds("sweep", "--study", "study.yaml", "--seeds", "1", "--vary", "snr=40,60")
    vary = ("--vary", "truncated-svd.tv_weight=1,9", "--vary", "snr=40,60")
    succeeds(*command("--no-flips", *vary, methods="truncated-svd"))
    file, out = (contents(folder / name) for name in ("file", "out"))
    same = {name for name in out if "sweep.zarr" in name or name in ("settings.json", "sweep.csv")}
    assert len(same) > 10 and all(file[name] == out[name] for name in same)
    (folder / "study.yaml").write_text(json.dumps({**study, "vary": {"snr": None}}))
    assert "vary snr" in refused("sweep", "--study", "study.yaml")
    (folder / "study.yaml").write_text(json.dumps({**study, "vary": {"snr": "40,60"}}))
    twice = refused("sweep", "--study", "study.yaml", "--snr", "60")
    assert twice.startswith("study.yaml: vary snr: --snr")
    (folder / "study.yaml").write_text(json.dumps({**study, "sbr": {"low": 1}}))
    assert "sbr" in refused("sweep", "--study", "study.yaml")


@pytest.mark.usefixtures("jit")
def test_a_picture_that_changed_is_photographed_anew(succeeds, refused):
    mine = ("--hidden-image", "mine.png", "--sbr", "1", "--ambient", "left.exr", "--no-flips")
    study = ("sweep", "plate", "-D", "resolution=21", "--hidden", "4x5", "--samples", "4", *mine,
             "--methods", "mine.py:Mine", "--out", "out")  # fmt: skip
    Image.new("RGB", (5, 4), "orange").save("mine.png")
    succeeds(*study)
    orange = read_exr(Path("out/photograph_mine_60dB.exr"))[0]
    Image.new("RGB", (5, 4), "blue").save("mine.png")
    assert "image 'mine'" in refused(*study)
    shutil.rmtree("out/sweep.zarr")  # as a run that was stopped before its first result
    succeeds(*study)
    blue = read_exr(Path("out/photograph_mine_60dB.exr"))[0]
    assert orange[..., 0].mean() > 5 * orange[..., 2].mean()
    assert blue[..., 2].mean() > 5 * blue[..., 0].mean()


@pytest.mark.usefixtures("jit")
def test_calibration_wins_back_what_a_ruler_costs(succeeds, monkeypatch):
    """By one that finds the truth: a real one of 13 numbers takes a minute."""

    def finds(scenario, _photograph, **_):
        asked.append({name: float(scenario.document.values[name]) for name in true})
        numbers = [SimpleNamespace(name=n, value=v, standard_error=1e-3) for n, v in true.items()]
        return SimpleNamespace(scenario=scenario.at(**true), parameters=numbers, trusted=False)

    errors = free_parameters(read_document(ps.find_scene("plate")))
    true = {n: float(read_document(ps.find_scene("plate")).values[n]) for n in errors}
    asked = []
    monkeypatch.setattr(ps.Scenario, "calibrate", finds)
    study = (
        "sweep", "plate", "-D", "resolution=21", "--hidden", "4x5", "--hidden-image", "bars",
        "--sbr", "5", "--ambient", "left.exr", "--no-flips", "--out", "out",
        "--methods", "truncated-svd,differencing",
    )  # fmt: skip
    said = succeeds(
        *study, "--vary", "assumed=true,ruler,calibrated", "--vary", "ruler=0,1", "--seeds", "2"
    )
    assert (
        re.search(" 2 rulers$", said, re.MULTILINE) and len(asked) == 2 * 2
    )  # photographs, not methods
    for of_ruler in (asked[:2], asked[2:]):
        assert of_ruler[0] == of_ruler[1]
    off = [(asked[k][name] - true[name]) / errors[name] for k in (0, 2) for name in true]
    # 26 normal draws: beyond 0.5 to 1.6 with an error rate of 1e-4.
    assert 0.5 < np.std(off) < 1.6 and len({*off}) == len(off)
    # More rulers, and no more calibrations.
    succeeds(*study, "--vary", "assumed=true,ruler", "--vary", "ruler=0:2:3", "--seeds", "2")
    succeeds("plot", "out", "--at", "assumed=ruler", "--out", "ruler.csv")
    succeeds("plot", "out", "--at", "ruler=0,1", "--reference", "assumed=true", "--out", "loss.tex")
    table = Path("loss.tex").read_text("utf-8")
    assert "PSNR in dB minus that of assumed = true:" in table and r"95 \%" in table
    with xr.open_dataset("out/sweep.zarr", engine="zarr", consolidated=False) as results:
        psnr = results.psnr.squeeze().sel(ruler=[0, 1])
        known, found = psnr.sel(assumed="true"), psnr.sel(assumed="calibrated")
        assert np.allclose(known, found, atol=1) and len({*known.values.ravel()}) == known.size
        assert (psnr.sel(assumed="ruler") < known).mean() > 0.7
        measured = results[["trusted", "within_1", "within_3"]].squeeze().sel(ruler=[0, 1])
        assert (measured.sel(assumed="calibrated").to_array() == [[[[0]]], [[[1]]], [[[1]]]]).all()
        assert measured.sel(assumed=["true", "ruler"]).to_array().isnull().all()
        numbers = results.squeeze().sel(ruler=[0, 1], assumed="calibrated")
        assert {*true} == {str(n)[6:] for n in numbers.data_vars if str(n).startswith("error.")}
        assert (numbers[f"error.{next(iter(true))}"] == 0).all()
        assert (numbers[f"claimed.{next(iter(true))}"] == 1e-3).all()


@pytest.mark.usefixtures("jit")
def test_only_methods_that_ask_for_rays_have_a_matrix_of_their_own(succeeds):
    assert "\nto make: 2 matrices\n" in succeeds(
        *(each for each in command() if each not in ("--samples", "16"))
    )
    with Path("out/sweep.csv").open(newline="") as stream:
        made = {(row["algorithm"], row["model"], row["samples"]) for row in csv.DictReader(stream)}
    assert made == {("preconditioned", "rendered", "16"), ("truncated-svd", "analytic", "nan")}


def test_bad_input_is_one_line(refused):
    for changes, offender in [
        ({"hidden-image": "bars"}, "--hidden-image"),
        ({"ambient": "left.exr,./left.exr"}, "--ambient"),
        ({"ambient": "left.exr,small.exr"}, "small.exr"),
        ({"scheduler": "nonsense://x"}, "'nonsense://x'"),
        ({"vary": "assumed=foo"}, "foo"),
        ({"vary": "ruler=0,1"}, "--vary ruler: also vary assumed"),
        ({"vary": "snrr=1"}, "did you mean 'snr'"),
        ({"vary": "snr=loud"}, "--vary snr=loud"),
        ({"vary": "=1"}, "--vary '=1'"),
        ({"vary": "sbr=1"}, "--vary sbr"),
        ({"vary": "samples=4"}, "--vary samples"),
        ({"vary": "resolution=21"}, "--vary resolution"),
        ({"vary": "assumed.resolution=42"}, "42"),
        ({"vary": "hidden=4x5,8x10"}, "--vary hidden: --hidden gives hidden, too"),
        ({"vary": "snr=40,60", "snr": 60}, "--vary snr: --snr gives snr, too"),
        ({"vary": "assumed.plate_width=-0.06,0.06"}, "--vary assumed.plate_width=-0.06"),
        ({"vary": "model=foo"}, "foo"),
        ({"vary": "truncated-svd.tv_weight=abc"}, "abc"),
        ({"vary": "scene=plate,plate.xml"}, "plate"),
        ({"truth": "truth.npy,y.npy"}, "--truth"),
        ({"study": "nothing.yaml"}, "nothing.yaml"),
        ({"ambient": "none"}, "--sbr: ambient none"),
        ({"ambient": "none,left.exr"}, "none alone"),
        ({"snr": "40,loud"}, "--snr loud"),
        ({"vary": "snr=0,.nan"}, "--vary snr=.nan"),
        ({"seeds": "many"}, "'--seeds': write a whole number. Try 'periscopy"),
    ]:
        assert offender in refused(*command(**changes))


def test_study_file_is_refused_as_the_command_line(refused, folder):
    for entry, option in [
        ("snr: 1:2.5", ("--snr", "1:2.5")),
        ("seeds: 0x8", ("--seeds", "0x8")),
        ("vary: {assumed.occluder_dx: 0:0.05}", ("--vary", "assumed.occluder_dx=0:0.05")),
        ("vary: {snr: 2020-01-01}", ("--vary", "snr=2020-01-01")),
    ]:
        (folder / "study.yaml").write_text(entry)
        assert refused(*command(), "--study", "study.yaml") == refused(*command(), *option)
    (folder / "study.yaml").write_text("flips: maybe")
    assert "'--flips': write true or false" in refused(*command(), "--study", "study.yaml")


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
@pytest.mark.usefixtures("jit", "every_wall_point")  # as the processes killed
def test_sweep_killed_twice_ends_in_the_same_bytes(succeeds, folder):
    succeeds(*command(out="whole"))
    # While the store is begun, and among the results.
    for writes in (3, 60):
        code = KILLED.format(writes=writes, arguments=command())
        ended = subprocess.run([sys.executable, "-c", code], cwd=folder, capture_output=True)
        assert ended.returncode == -signal.SIGKILL, ended.stderr
        assert not (folder / "out" / "sweep.csv").exists()
    marks = list((folder / "out/sweep.zarr/making/finished").glob("*.json"))
    assert 0 < len(marks) < 8
    succeeds(*command())
    assert contents(folder / "out") == contents(folder / "whole")


@pytest.mark.usefixtures("finished")
def test_folder_of_another_sweep_is_refused_before_rendering(monkeypatch, refused, folder):
    np.save(folder / "other.npy", np.load(folder / "y.npy") + 1)
    monkeypatch.setattr(ps.Scenario, "transport", None)
    for change, key in [
        (("--seed", "1"), "base_seed"),
        (("--photograph", "other.npy"), "photograph"),
        (("--samples", "5"), "samples"),
        (("-D", "occluder_dx=0.001"), "parameters.occluder_dx"),
    ]:
        assert key in refused(*command(*change, methods=BOTH)), change
    with (folder / "mine.py").open("a") as stream:
        stream.write("\n# changed\n")
    assert "mine.py:Mine" in refused(*command(methods=BOTH))
    shutil.rmtree(folder / "out")
    (folder / "out").mkdir()
    (folder / "out" / "sweep.csv").write_text("old")
    assert refused(*command()).startswith("out ")


@pytest.mark.usefixtures("jit")
def test_method_that_cannot_be_fitted_is_named_and_can_be_corrected(periscopy, succeeds):
    outcome = periscopy(*command(methods="mine.py:Unfit"))
    assert outcome.code == 2 and "'mine.py:Unfit'" in outcome.err
    given = {"sbr": "2", "snr": 50, "ambient": "lamp.exr"}
    shown = succeeds(*command(methods="mine.py:Unfit,mine.py:Mine", **given))
    assert "mine.py:Unfit failed on 1 of 1" in shown and "KeyError: 'no'" in shown
    results = read_sweep(Path("out/sweep.zarr")).squeeze()
    assert results["psnr"].isnull().values.tolist() == [True, False]
