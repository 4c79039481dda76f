import csv
import json
import signal
import subprocess
import sys
from types import SimpleNamespace

import numpy as np
import pytest
import xarray as xr
from PIL import Image

import periscopy_sim as ps
from periscopy_sim.cli import scene as scenes
from periscopy_sim.cli.folder_lock import alone_in
from periscopy_sim.cli.sweep_lists import parse_ambient, parse_ratios
from periscopy_sim.shipped import ADVERSARIAL, REALISTIC
from periscopy_sim.storage.exr import write_exr

pytestmark = pytest.mark.usefixtures("few_lights")

SCENE = ("plate", "-D", "resolution=21", "--hidden", "4x5", "--samples", "4")
RNG = np.random.default_rng(31)
TRUTH = RNG.uniform(0.1, 1, (4, 5, 3))
FILES = {
    *(
        ".lock",
        "settings.json",
        "A.npy",
        "A.json",
        "sweep.zarr",
        "sweep.csv",
        "sweep.png",
        "seconds.csv",
    )
}
MINE = """
import numpy as np

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
        raise {error}("no")
"""


@pytest.fixture
def given(tmp_path):
    """What a sweep needs, in the current folder: a photograph, its truth, ambient light."""
    x, z = np.meshgrid(np.linspace(-1, 1, 21), np.linspace(-1, 1, 21))
    for name, light in {"left": 2 - x, "lamp": 1 / (2 + x**2 + z)}.items():
        write_exr(tmp_path / f"{name}.exr", light[..., None] * [1.0, 0.9, 0.8], {})
    write_exr(tmp_path / "small.exr", np.ones((20, 21, 3)), {})
    np.save(tmp_path / "truth.npy", TRUTH)
    np.save(tmp_path / "y.npy", RNG.uniform(1, 2, (21, 21, 3)))
    (tmp_path / "mine.py").write_text(MINE.format(error="KeyError"))
    return tmp_path


def arguments(**changes):
    options = {
        "photograph": "y.npy",
        "truth": "truth.npy",
        "ambient": "left.exr,lamp.exr",
        "sbr": "0.5,5",
        "methods": "preconditioned,truncated-svd",
        "out": "out",
        **changes,
    }
    listed = [
        (f"--{name.replace('_', '-')}", *([] if value is True else [value]))
        for name, value in options.items()
        if value is not None
    ]
    return ("sweep", *SCENE, *(str(part) for pair in listed for part in pair))


def contents(folder):
    files = [folder / "sweep.csv", *(folder / "sweep.zarr").rglob("*")]
    return {str(path.relative_to(folder)): path.read_bytes() for path in files if path.is_file()}


# -- what is written -----------------------------------------------------------------------------


@pytest.mark.usefixtures("jit")
def test_sweep_writes_store_table_picture_and_prints_the_means(succeeds, given):
    shown = succeeds(*arguments(methods="preconditioned,mine.py:Mine,mine.py:Failing", seeds=2))
    out = given / "out"
    assert {path.name for path in out.iterdir()} == FILES
    with xr.open_dataset(out / "sweep.zarr", engine="zarr", consolidated=False) as results:
        assert list(results["background"].values) == [
            *("left", "left up-down", "left left-right", "left both"),
            *("lamp", "lamp up-down", "lamp left-right", "lamp both"),
        ]
        assert list(results["sbr"].values) == [0.5, 5] and list(results["seed"].values) == [0, 1]
        errors = results["mean_squared_error"].transpose("method", "sbr", ...).values
        record = results.attrs
    with (out / "sweep.csv").open(newline="") as stream:
        rows = list(csv.DictReader(stream))
    assert len(rows) == 3 * 8 * 2 * 2
    assert {row["failure"] for row in rows if row["method"] == "mine.py:Failing"} == {
        "KeyError: 'lost'"
    }
    lines = [line.split() for line in shown.splitlines()]
    means = errors.reshape(3, 2, -1).mean(axis=2)
    assert ["mean", "squared", "error", "0.5", "5"] in lines
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


@pytest.mark.usefixtures("jit", "given")
def test_errors_are_those_of_the_public_functions(succeeds):
    succeeds(*arguments(methods="truncated-svd", flips=None, no_flips=True, snr=45, seed=3))
    scenario = ps.load_scenario(ps.find_scene("plate"), (4, 5), {"resolution": "21"})
    A = ps.render_transport(scenario, samples=4, seed=3)
    method = ps.TruncatedSVD(A, hidden_shape=(4, 5), channel_gain=scenario.channel_gain)
    y = np.load("y.npy")
    light = ps.read_photograph("lamp.exr", (21, 21)).values
    whole = ps.Sweep(y, TRUTH, {"lamp": light}, {"": method}, [5], 45, seed=3)
    image = method.reconstruct(whole.photograph("lamp", 5, 0))
    with xr.open_dataset("out/sweep.zarr", engine="zarr", consolidated=False) as results:
        cell = results.isel(method=0, seed=0).sel(background="lamp", sbr=5)
        assert np.allclose(cell["reconstruction"], image, rtol=1e-4, atol=1e-6)
        assert float(cell["psnr"]) == pytest.approx(ps.psnr(image, TRUTH), abs=1e-3)
        assert results.sizes["background"] == 2


@pytest.mark.usefixtures("jit")
def test_photograph_and_shipped_light_are_rendered_once(monkeypatch, succeeds, given):
    asked = []

    def ambient_photographs(names, scenario, folder, seed):
        asked.append((list(names), scenario.photograph_shape, str(folder), seed))
        return {name: np.full((21, 21, 3), 2.0) for name in names}

    fake = SimpleNamespace(ambient_photographs=ambient_photographs)
    monkeypatch.setitem(sys.modules, "periscopy_sim.cli.ambient", fake)
    command = arguments(
        photograph=None, truth=None, hidden_image="bars", ambient="snow,left.exr", sbr="1", seed=2
    )
    shown = succeeds(*command)
    out = given / "out"
    assert asked == [(["snow"], (21, 21), "out/ambient", 2)]
    assert {path.name for path in out.iterdir()} == FILES | {"photograph.exr"}
    assert "wrote out/A.npy 441x20" in shown and "wrote out/photograph.exr 21x21" in shown
    before = contents(out)
    rendered = (out / "A.npy").stat().st_mtime_ns, (out / "photograph.exr").stat().st_mtime_ns
    assert "A.npy" not in succeeds(*command)
    assert rendered == (
        (out / "A.npy").stat().st_mtime_ns,
        (out / "photograph.exr").stat().st_mtime_ns,
    )
    assert contents(out) == before


# -- going on ------------------------------------------------------------------------------------

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


@pytest.mark.usefixtures("jit")
def test_sweep_killed_twice_ends_in_the_same_bytes(succeeds, given):
    succeeds(*arguments(out="whole"))
    # In the midst of the matrix, and among the results.
    for writes in (3, 50):
        code = KILLED.format(writes=writes, arguments=arguments())
        ended = subprocess.run([sys.executable, "-c", code], cwd=given, capture_output=True)
        assert ended.returncode == -signal.SIGKILL, ended.stderr
        assert not (given / "out" / "sweep.csv").exists()
    marks = list((given / "out" / "sweep.zarr" / "complete").rglob("[0-9]"))
    assert 0 < len(marks) < 16
    succeeds(*arguments())
    assert contents(given / "out") == contents(given / "whole")


@pytest.mark.usefixtures("jit", "given")
def test_interrupt_says_how_to_go_on(monkeypatch, periscopy, succeeds):
    def interrupt(*_):
        raise KeyboardInterrupt

    with monkeypatch.context() as patch:
        patch.setattr("periscopy_sim.evaluation.sweep_store.SweepStore.write", interrupt)
        outcome = periscopy(*arguments())
    assert (outcome.code, outcome.err) == (
        130,
        "periscopy: error: interrupted; the same command goes on where it stopped\n",
    )
    succeeds(*arguments())


@pytest.mark.usefixtures("jit")
def test_folder_of_another_sweep_is_refused_before_rendering(monkeypatch, succeeds, refused, given):
    succeeds(*arguments())
    np.save(given / "other.npy", np.load(given / "y.npy") + 1)
    monkeypatch.setattr(scenes, "transport", None)
    monkeypatch.setattr(scenes, "read_transport", None)
    for change, difference in [
        (("--sbr", "0.5,4"), "sbr [0.5, 5.0], here [0.5, 4.0]"),
        (("--methods", "preconditioned"), "methods [["),
        (("--methods", "truncated-svd,preconditioned"), "methods [["),
        (("--ambient", "lamp.exr,left.exr"), "ambient [["),
        (("--snr", "50"), "snr 60.0, here 50.0"),
        (("--seed", "1"), "base_seed 0, here 1"),
        (("--seeds", "2"), "seeds 1, here 2"),
        (("--no-flips",), "flips true, here false"),
        (("--photograph", "other.npy"), "photograph "),
        (("--samples", "5"), "samples 4, here 5"),
        (("--hidden", "3x5"), "hidden_shape [4, 5], here [3, 5]"),
        (("-D", "occluder_dx=0.001"), 'parameters.occluder_dx unset, here "0.001"'),
    ]:
        line = refused(*arguments(), *change)
        assert line.startswith(f"out holds another sweep ({difference}"), change


@pytest.mark.usefixtures("jit")
def test_own_method_that_changed_is_another_sweep(succeeds, refused, given):
    command = arguments(methods="mine.py:Mine", sbr="1")
    succeeds(*command)
    (given / "mine.py").write_text(MINE.format(error="KeyError") + "\n# changed\n")
    assert "out holds another sweep (methods" in refused(*command)


@pytest.mark.usefixtures("jit")
@pytest.mark.parametrize("error", ["KeyError", "ValueError", "PermissionError"])
def test_method_that_cannot_be_fitted_is_named_and_can_be_corrected(
    error, periscopy, succeeds, given
):
    (given / "mine.py").write_text(MINE.format(error=error))
    outcome = periscopy(*arguments(methods="mine.py:Unfit"))
    line = next(n for n, text in enumerate(MINE.splitlines(), 1) if "raise {error}" in text)
    raised = eval(error)("no")
    assert (outcome.code, outcome.err) == (
        2,
        f"periscopy: error: method 'mine.py:Unfit' cannot be fitted: {error}: {raised} "
        f"(mine.py:{line})\n",
    )
    matrix = (given / "out" / "A.npy").stat().st_mtime_ns
    # Whatever does not bear upon the matrix may be another.
    succeeds(*arguments(methods="mine.py:Mine", sbr="2", snr=50, seeds=2, ambient="lamp.exr"))
    assert (given / "out" / "A.npy").stat().st_mtime_ns == matrix
    succeeds(
        *arguments(methods="mine.py:Mine", sbr="2", snr=50, seeds=2, ambient="lamp.exr", out="b")
    )
    assert contents(given / "out") == contents(given / "b")
    assert (given / "out" / "settings.json").read_bytes() == (
        given / "b" / "settings.json"
    ).read_bytes()


@pytest.mark.usefixtures("jit")
@pytest.mark.parametrize(
    ("change", "difference"),
    [
        (("--samples", "5"), "samples 4, here 5"),
        (("--seed", "1"), "base_seed 0, here 1"),
        (("-D", "occluder_dx=0.001"), 'parameters.occluder_dx unset, here "0.001"'),
        (("--hidden", "3x5"), "hidden_shape [4, 5], here [3, 5]"),
        (("--truth", "bars"), "truth "),
    ],
)
def test_what_was_rendered_for_another_sweep_is_refused_before_there_are_results(
    change, difference, periscopy, refused, given
):
    if "--truth" in change:
        np.save(given / "y.npy", np.ones((21, 21, 3)))
    assert periscopy(*arguments(methods="mine.py:Unfit")).code == 2
    assert refused(*arguments(), *change).startswith(f"out holds another sweep ({difference}")


HOLDING = """
import sys, time
from pathlib import Path
from periscopy_sim.cli.folder_lock import alone_in
with alone_in(Path("out")):
    print("held", flush=True)
    time.sleep(600)
"""


@pytest.mark.usefixtures("jit")
def test_folder_in_which_another_process_is_at_work_is_refused_until_it_is_killed(
    refused, succeeds, given
):
    with subprocess.Popen(
        [sys.executable, "-c", HOLDING], cwd=given, stdout=subprocess.PIPE, text=True
    ) as other:
        try:
            assert other.stdout.readline() == "held\n"
            line = refused(*arguments())
        finally:
            other.kill()
    assert line.startswith("another process is at work in out; ")
    succeeds(*arguments())


def test_folder_is_free_again_after_an_error(tmp_path):
    for _ in range(2):
        with pytest.raises(KeyError), alone_in(tmp_path):
            raise KeyError
    with alone_in(tmp_path), pytest.raises(ps.PeriscopyError), alone_in(tmp_path):
        pass


@pytest.mark.parametrize("name", ["A.npy", "ambient", "photograph.exr", "sweep.zarr", "sweep.csv"])
def test_files_of_unknown_origin_are_not_taken_up(name, refused, given):
    (given / "out").mkdir()
    (given / "out" / name).write_text("old")
    assert f"out holds {name} but no settings.json" in refused(*arguments())


@pytest.mark.parametrize("content", ["{", "[1, 2]", "3"])
def test_damaged_settings_are_refused(content, refused, given):
    (given / "out").mkdir()
    (given / "out" / "settings.json").write_text(content)
    assert refused(*arguments()) == "out/settings.json: is damaged; name another folder"


# -- what is refused -----------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("changes", "message"),
    [
        ({"photograph": None}, "give either --photograph with --truth, or --hidden-image"),
        ({"truth": None}, "give either --photograph with --truth, or --hidden-image"),
        ({"hidden_image": "bars"}, "give either --photograph with --truth, or --hidden-image"),
        ({"photograph": None, "truth": None}, "give either --photograph with --truth"),
        ({"methods": "magic"}, "no method 'magic'; use preconditioned, differencing, "),
        ({"methods": "preconditioned,"}, "empty name"),
        ({"methods": "pseudoinverse,pseudoinverse"}, "--methods has pseudoinverse twice"),
        ({"methods": "none.py:Mine"}, "there is no file none.py"),
        ({"methods": "mine.py:Other"}, "has no attribute 'Other'"),
        ({"ambient": "moon"}, "'moon' is no lighting condition; use an EXR file, a folder of them"),
        ({"ambient": "moon"}, "high_sun"),
        ({"ambient": "left.exr,left.exr"}, "--ambient has left.exr twice"),
        ({"ambient": "left.exr,./left.exr"}, "--ambient has left twice"),
        ({"ambient": "all,snow,high_sun"}, "--ambient has high_sun twice"),
        ({"ambient": "empty"}, "the folder holds no EXR file"),
        ({"ambient": "none.exr"}, "none.exr: no such file"),
        ({"ambient": "left.exr,small.exr"}, "small.exr: 20 x 21 pixels"),
        ({"sbr": "-1"}, "--sbr '-1' is no list of positive ratios"),
        ({"sbr": "1,0"}, "--sbr '1,0' is no list of positive ratios"),
        ({"sbr": "many"}, "--sbr 'many' is no list of positive ratios"),
        ({"sbr": "1,1.0"}, "--sbr has 1 twice"),
        ({"snr": "nan"}, "'--snr': nan is not a finite number of dB from -100 to 300"),
        ({"snr": "inf"}, "'--snr': inf is not a finite number of dB from -100 to 300"),
        ({"snr": "-1e5"}, "'--snr': -100000 is not a finite number of dB from -100 to 300"),
        ({"snr": "abc"}, "'--snr'"),
        ({"seeds": "0"}, "'--seeds'"),
        ({"truth": "sofa"}, "image 'sofa' does not exist"),
        ({"photograph": "small.exr"}, "small.exr: 20 x 21 pixels"),
        ({"scheduler": "tcp://127.0.0.1:1"}, "no Dask scheduler answers at 'tcp://127.0.0.1:1'"),
    ],
)
def test_bad_input_is_one_line(changes, message, refused, given, monkeypatch):
    monkeypatch.setattr("periscopy_sim.evaluation.workers.PATIENCE", 0.2)
    (given / "empty").mkdir()
    assert message in refused(*arguments(**changes))


def test_place_that_is_a_file_is_refused(refused, given):
    (given / "out").write_text("kept")
    assert "cannot write out" in refused(*arguments())


# -- lists ---------------------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("text", "ratios"),
    [
        ("0.5", [0.5]),
        ("0.1,1, 10", [0.1, 1, 10]),
        ("0.1:10:log:3", [0.1, 1, 10]),
        ("0.1:10:log:9", [0.1, 0.177828, 0.316228, 0.562341, 1, 1.77828, 3.16228, 5.62341, 10]),
        ("10:1:lin:4", [10, 7, 4, 1]),
        ("2:8:log:1", [2]),
    ],
)
def test_ratios_are_read(text, ratios):
    assert parse_ratios(text) == ratios


@pytest.mark.parametrize(
    "text",
    [
        *(
            "",
            ",",
            "1,,2",
            "nan",
            "inf",
            "-1",
            "0",
            "1;2",
            "0:1:log:3",
            "-1:1:lin:3",
            "1:inf:log:3",
        ),
        *(
            "1:2",
            "1:2:log",
            "1:2:log:0",
            "1:2:log:x",
            "1:2:cubic:3",
            "1:2:log:3:4",
            "1:2:log:9999999",
        ),
        *("1:1:log:2",),
    ],
)
def test_what_is_no_list_of_ratios_is_refused(text):
    with pytest.raises(ps.PeriscopyError, match="--sbr"):
        parse_ratios(text)


def test_groups_of_ambient_light_are_shipped_and_apart():
    assert list(parse_ambient("all")) == list(REALISTIC) and len(REALISTIC) == 8
    assert list(parse_ambient("adversarial")) == list(ADVERSARIAL)
    assert list(parse_ambient("adversarial,all")) == [*ADVERSARIAL, *REALISTIC]
    assert set(parse_ambient("all,snow").values()) == {None}


def test_folder_stands_for_its_files(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    (tmp_path / "lights").mkdir()
    for name in ("b.exr", "a.exr", "notes.txt"):
        (tmp_path / "lights" / name).touch()
    found = parse_ambient("lights,snow,more/c.exr")
    assert {name: str(path) for name, path in found.items()} == {
        "a": "lights/a.exr", "b": "lights/b.exr", "snow": "None", "c": "more/c.exr"
    }  # fmt: skip
    assert list(found) == ["a", "b", "snow", "c"]
