import json
import os
import shlex
import subprocess
import sys
from dataclasses import replace
from importlib import metadata

import numpy as np
import pytest
from PIL import Image
from scipy.io import savemat

import periscopy_sim as ps
from periscopy_sim.cli import start
from periscopy_sim.rendering.variant import INSTALL_LLVM, examine_variants
from periscopy_sim.storage.published import published_sets

jit = pytest.mark.usefixtures("jit", "few_lights", "few_paths")

TINY = ("demo", "--hidden", "6x7", "--resolution", "24", "--effort", "0.02")
METHODS = ("noise-aware", "preconditioned")


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


def examine(**environment):
    """Run `periscopy doctor` alone: in this process the variant is chosen already."""
    ended = subprocess.run(
        [sys.executable, "-m", "periscopy_sim", "doctor"],
        env={**os.environ, **environment},
        capture_output=True,
        text=True,
        timeout=120,
    )
    # Without LLVM, Dr.Jit says so itself as soon as it is imported.
    lines = ended.stderr.splitlines(keepends=True)
    ended.stderr = "".join(line for line in lines if not line.startswith("jitc_llvm_init()"))
    return ended


def test_versions_and_variants_are_shown():
    works = {report.name: report.works for report in examine_variants()}
    ended = examine(PERISCOPY_VARIANT="")
    assert ended.returncode == 0
    lines = dict(line.split(maxsplit=1) for line in ended.stdout.splitlines())
    for package in ("periscopy-sim", "mitsuba", "drjit", "numpy", "scipy", "numba"):
        assert lines[package] == metadata.version(package)
    assert sys.version.startswith(lines["python"].split()[0])
    for name, here in works.items():
        assert lines[name].startswith("works: " if here else "does not work: ")
    best = next(name for name, here in works.items() if here)
    assert lines["rendering"] == f"with {best}"
    assert ended.stderr == "" or best == "scalar_rgb"


def test_llvm_that_the_users_variable_names_in_vain_is_shown_with_the_variable():
    if any(report.works for report in examine_variants() if report.name.startswith("cuda")):
        pytest.skip("CUDA works here, which is preferred to LLVM")
    ended = examine(PERISCOPY_VARIANT="", DRJIT_LIBLLVM_PATH="no-such-library")
    assert ended.returncode == 0
    assert ended.stdout.splitlines()[-1] == "rendering with scalar_rgb"
    assert "no libLLVM loads (by DRJIT_LIBLLVM_PATH, no-such-library)" in ended.stdout
    assert INSTALL_LLVM not in ended.stdout


@pytest.fixture
def nowhere(monkeypatch, tmp_path):
    """No server answers, and nothing is cached."""
    for variable in ("HTTPS_PROXY", "https_proxy", "ALL_PROXY", "all_proxy"):
        monkeypatch.setenv(variable, "http://127.0.0.1:9")
    monkeypatch.setenv("PERISCOPY_DATA", str(tmp_path / "cache"))
    monkeypatch.setattr("pooch.core.time.sleep", lambda _: None)


def test_sets_are_listed_without_a_name(succeeds):
    assert [line.split()[0] for line in succeeds("fetch").splitlines()] == [*published_sets()]


@pytest.mark.usefixtures("nowhere")
def test_no_network_is_one_line(periscopy):
    outcome = periscopy("fetch", "saunders2019-chair", "--out", "out")
    assert (outcome.code, outcome.out) == (2, "")
    assert outcome.err.count("\n") == 1 and "saunders2019" in outcome.told


def test_folder_holds_captures_and_what_reconstruct_reads(succeeds, tmp_path, monkeypatch):
    name, known = next(iter(published_sets().items()))
    image = np.tile([[2.0, 4.0], [4.0, 6.0]], (126, 126))
    (tmp_path / "cache" / "a").mkdir(parents=True)
    savemat(
        tmp_path / "cache" / "a" / "b.mat", {"image": image, "shutter_speed": 1, "iterations": 1}
    )
    small = replace(known, files={"a/b.mat": ""}, layout="captures")
    monkeypatch.setattr(start, "published_sets", lambda: {name: small})
    monkeypatch.setattr(start, "fetch_set", lambda *_: tmp_path / "cache")
    succeeds("fetch", name, "--out", "out")
    assert {file.name for file in (tmp_path / "out" / "a").iterdir()} == {"b.mat", "b.npz"}
    assert ps.read_photograph(tmp_path / "out" / "a" / "b.npz", (126, 126)).values.min() == 2
