"""Every command once, in a process of its own, as a user starts it after installation."""

import os
import signal
import subprocess
import sys

import numpy as np
import pytest

import periscopy_sim as ps
from periscopy_sim.cli import MODULES
from periscopy_sim.laboratory.document import EXAMPLE
from periscopy_sim.rendering.variant import LLVM_FILE, OVERRIDE, own_llvm
from periscopy_sim.storage.formats.exr import write_exr

PLATE = ("-D", "resolution=16")
SIZED = (*PLATE, "--hidden", "3x4")
ON_PLATE = ("--scene", "plate", *SIZED)
DATASET = """
{count: 2, hidden: 3x4, samples_per_geometry: 2, samples_per_shard: 2,
 splits: {train: 1, validation: 0, test: 0},
 scenes: [{scene: plate, parameters: {resolution: 16}}],
 hidden_images: [{kind: shapes}], ambient: [{kind: lamps}]}
"""
ARGUMENTS = {
    "demo": ("--hidden", "3x4", "--resolution", "12", "--effort", "0.001", "--out", "demo"),
    "doctor": (),
    "tutorial": ("--out", "mine"),
    "fetch": (),
    "lab": (EXAMPLE, "--out", "lab.xml"),
    "draw": ("plate", "--out", "plate.png"),
    "view": ("plate", *SIZED, "--port", "0"),
    "prepare": ("wall.npy", "--scene", "plate", *PLATE, "--out", "ready.exr"),
    "reconstruct": ("wall.npy", *ON_PLATE, "--out", "image"),
    "video": ("frames.npy", *ON_PLATE, "--out", "video"),
    "calibrate": (
        *("wall.npy", *ON_PLATE, "--shown", "mushroom", "--free", "occluder_dx=0.003"),
        *("--uncertain", "none", "--out", "calibrated.xml"),
    ),
    "photograph": ("plate", "mushroom", *SIZED, "--samples", "4", "--out", "photo.exr"),
    "transport": ("plate", *SIZED, "--out", "A.npy"),
    "ambient": ("overcast", "--scene", "plate", *PLATE, "--target", "1", "--out", "ambient"),
    "sweep": (
        *("plate", *SIZED, "--photograph", "wall.npy", "--truth", "mushroom", "--sbr", "1"),
        *("--ambient", "wall.exr", "--no-flips", "--methods", "noise-aware", "--out", "sweep"),
    ),
    "dataset": ("data.yaml", "--out", "data.zarr"),
    "analyze": ("plate", *SIZED, "--out", "analysis"),
    "design": (
        *("plate", *SIZED, "--vary", "occluder_dx=0:0.01", "--grid", "2", "--images", "none"),
        *("--out", "design"),
    ),
}
EXTRAS = {"view": "viser", "sweep": "xarray", "dataset": "zarr"}


@pytest.fixture(scope="module")
def inputs(tmp_path_factory):
    """A folder with a photograph of the plate, a stack of two, and a data set's description."""
    folder = tmp_path_factory.mktemp("inputs")
    scenario = ps.load_scenario("plate", (3, 4), {"resolution": 16})
    image = ps.read_hidden_image(ps.find_image("mushroom"), (3, 4)).reshape(12, 3)
    wall = (ps.analytic_transport(scenario) @ image).reshape(16, 16, 3)
    wall = wall / wall.mean() + np.random.default_rng(0).normal(0, 1e-3, wall.shape)
    np.save(folder / "wall.npy", wall)
    np.save(folder / "frames.npy", np.stack([wall, wall]))
    write_exr(folder / "wall.exr", wall, {})
    (folder / "data.yaml").write_text(DATASET)
    return folder


@pytest.mark.usefixtures("jit")
@pytest.mark.parametrize("command", MODULES)
def test_command_runs_in_a_fresh_process(command, inputs):
    pytest.importorskip(EXTRAS.get(command, "numpy"))
    # Without what the process of the tests has chosen; a notebook's own values are a user's.
    chosen = {LLVM_FILE: "", OVERRIDE: "", "MPLBACKEND": "nonsense"}
    if os.environ.get(LLVM_FILE) != str(own_llvm()):
        del chosen[LLVM_FILE]
    with subprocess.Popen(
        [sys.executable, "-m", "periscopy_sim", command, *map(str, ARGUMENTS[command])],
        cwd=inputs, env={**os.environ, **chosen, "PYTHONUNBUFFERED": "1"}, text=True,
        stdout=subprocess.PIPE, stderr=subprocess.PIPE,
    ) as process:  # fmt: skip
        if command == "view":  # it has begun to serve
            process.stdout.readline()
            process.send_signal(signal.SIGINT)
        _, complaint = process.communicate(timeout=120)
    assert process.returncode == 0, complaint
    place = dict(zip(ARGUMENTS[command], ARGUMENTS[command][1:], strict=False)).get("--out", ".")
    assert (inputs / place).exists()
