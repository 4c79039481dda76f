"""Every command once, in a process of its own, as a user starts it after installation."""

import json
import os
import signal
import subprocess
import sys
import time
from importlib.util import find_spec

import numpy as np
import pytest

import periscopy_sim as ps
from periscopy_sim.cli import MODULES
from periscopy_sim.evaluation.sweep import Sweep, World, run_sweep
from periscopy_sim.laboratory.document import EXAMPLE
from periscopy_sim.rendering.variant import LLVM_FILE, OVERRIDE, own_llvm
from periscopy_sim.storage.rasters import write_exr

PLATE = "plate -D resolution=16"
SIZED = f"{PLATE} --hidden 3x4"
COMMANDS = f"""
demo --hidden 2x3 --resolution 8 --effort 0.001 --out demo
doctor
tutorial --out mine
fetch
lab lab.yaml --out lab.xml
draw {PLATE} --out plate.png
view {SIZED} --port 0
watch wall.py:frame --scene {SIZED} --port 0 --out watched
prepare wall.npy --scene {PLATE} --out ready.exr
reconstruct wall.npy --scene {SIZED} --out image
video frames.npy --scene {SIZED} --out video
calibrate wall.npy --scene {SIZED} --shown mushroom --free occluder_dx=0.003 --out calibrated.xml
photograph {SIZED} mushroom --samples 4 --out photo.exr
transport {SIZED} --out A.npy
ambient overcast --scene plate -D resolution=4 --target 1 --out ambient
sweep {SIZED} --photograph wall.npy --truth mushroom --ambient none --methods differencing --out s
plot done --out done.png
dataset data.yaml --out data.zarr
analyze {SIZED} --out analysis
design {SIZED} --vary occluder_dx=0:0.01 --grid 2 --images none --out design
"""
WORDS = {words[0]: words for words in map(str.split, COMMANDS.splitlines()) if words}
DATASET = """
{count: 2, hidden: 3x4, samples_per_geometry: 2, samples_per_shard: 2,
 scenes: [{scene: plate, parameters: {resolution: 16}}],
 hidden_images: [{kind: shapes}], ambient: [{kind: lamps}]}
"""
CAMERA = """
import numpy as np
codes = np.clip(100 * np.load("wall.npy"), 0, 255).astype(np.uint8)
frame = iter([codes, codes, None]).__next__
"""
WARNINGS = {
    "demo": ["the photograph hardly shows a hidden image"],
    "watch": ["decoded by the sRGB curve", "saturated: "],
    "calibrate": ["determines the parameters less well"],
    "dataset": ["no geometry is for validation or test"],
}
"""Words of each warning that a command prints of these small inputs; the others print none."""

WARNING = "periscopy: warning: "
EXTRAS = {
    "view": "websockets",
    "watch": "websockets",
    "sweep": "xarray",
    "plot": "xarray",
    "dataset": "zarr",
}


@pytest.fixture(scope="module")
def inputs(tmp_path_factory):
    """A folder with a photograph of the plate, and what else the commands read."""
    folder = tmp_path_factory.mktemp("inputs")
    scenario = ps.load_scenario("plate", (3, 4), {"resolution": 16})
    image = ps.read_hidden_image(ps.find_image("mushroom"), (3, 4)).reshape(12, 3)
    wall = (ps.analytic_transport(scenario) @ image).reshape(16, 16, 3)
    wall = wall / wall.mean() + np.random.default_rng(0).normal(0, 1e-3, wall.shape)
    np.save(folder / "wall.npy", wall)
    np.save(folder / "frames.npy", np.stack([wall, wall]))
    write_exr(folder / "wall.exr", wall, {})
    (folder / "wall.py").write_text(CAMERA)
    if find_spec("xarray"):
        method = ps.TruncatedSVD.for_scene(scenario, ps.analytic_transport(scenario))
        world = World({"p": wall}, {"p": image.reshape(3, 4, 3)}, {"b": wall}, {"m": method})
        run_sweep(Sweep(world, sbrs=[1]), folder / "done")
    (folder / "data.yaml").write_text(DATASET)
    (folder / "lab.yaml").write_bytes(EXAMPLE.read_bytes())
    return folder


def shown_by(names):
    """Run these commands always, the others by `make test-thorough`."""
    return [pytest.param(n, marks=[] if n in names else pytest.mark.thorough) for n in MODULES]


@pytest.mark.usefixtures("jit")
@pytest.mark.parametrize("command", shown_by({"view"}))
def test_command_runs_in_a_fresh_process(command, inputs):
    pytest.importorskip(EXTRAS.get(command, "numpy"))
    # What the tests' own process has chosen does not count; what a notebook passes on may be wrong.
    chosen = {LLVM_FILE: "", OVERRIDE: "", "MPLBACKEND": "nonsense", "PYTHONUNBUFFERED": "1"}
    if os.environ.get(LLVM_FILE) != str(own_llvm()):
        del chosen[LLVM_FILE]
    with subprocess.Popen(
        [sys.executable, "-m", "periscopy_sim", *WORDS[command]], env={**os.environ, **chosen},
        cwd=inputs, stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True,
    ) as process:  # fmt: skip
        if command == "view":  # it has begun to serve
            process.stdout.readline()
            process.send_signal(signal.SIGINT)
        interrupted = time.monotonic()
        said, complaint = process.communicate(timeout=120)
    assert process.returncode == 0, complaint
    assert all(line.startswith("periscopy: ") for line in complaint.splitlines()), complaint
    check_warnings(command, [each for each in complaint.splitlines() if WARNING in each])
    if command == "view":
        assert said == "closed\n" and time.monotonic() - interrupted < 2
    assert "--out" not in WORDS[command] or (inputs / WORDS[command][-1]).exists()


def check_warnings(command, lines):
    """Compare the distinct warnings of a command with those that it must print."""
    # A verdict comes when it is ready, which may be after the last frame.
    settled = [line for line in lines if command != "watch" or "does not fit" not in line]
    expected, distinct = WARNINGS.get(command, []), [*dict.fromkeys(settled)]
    assert len(distinct) == len(expected), distinct
    assert all(words in line for words, line in zip(expected, distinct, strict=True)), distinct


KEYS = {
    "demo": ["noise-aware", "preconditioned", "verdict"],
    "doctor": ["python", "numpy", "cores", "verdict"],
    "fetch": ["saunders2019-chair"],
    "watch": ["frames_shown", "frames_dropped"],
    "prepare": ["pixels_left_out", "defects_left_out"],
    "reconstruct": ["method", "unexplained", "verdict", "seconds"],
    "video": ["median", "frames_per_second", "verdict"],
    "calibrate": ["parameters", "trusted", "verdict"],
    "photograph": ["image_sha256", "samples"],
    "transport": ["samples", "transport_error"],
    "ambient": ["relative_error"],
    "sweep": ["psnr", "computed", "results"],
    "dataset": ["made", "samples"],
    "analyze": ["condition_A", "bound_ratio"],
    "design": ["best", "ranking"],
}
"""Some of what `--json` prints of each command, beside files and warnings."""

AGAINST = "does not fit", "Do not trust"
"""Words of verdicts that `-q` prints as warnings; small inputs have them."""


@pytest.fixture
def run(inputs, periscopy, monkeypatch):
    """Run a command of the table in the tests' own process, with another option."""

    def run(command, option):
        pytest.importorskip(EXTRAS.get(command, "numpy"))
        monkeypatch.chdir(inputs)
        *words, out = WORDS[command]
        return periscopy(*words, option[1:] + out if "--out" in words else out, option)

    return run


@pytest.mark.usefixtures("jit")
@pytest.mark.parametrize("command", shown_by({"prepare", "watch", "photograph"}))
def test_quiet_prints_nothing(command, run):
    if command == "view":
        pytest.skip("runs until it is interrupted")
    quiet = run(command, "-q")
    assert quiet.code == 0
    assert len(quiet.out.splitlines()) == (command == "watch")  # whose page has an address
    assert all(line.startswith(WARNING) for line in quiet.told.splitlines())
    lines = quiet.told.splitlines()
    check_warnings(command, [line for line in lines if not any(each in line for each in AGAINST)])


@pytest.mark.usefixtures("jit")
@pytest.mark.parametrize(
    "command", shown_by({*MODULES} - {"demo", "draw", "video", "calibrate", "dataset", "design"})
)
def test_json_is_one_object(command, run, inputs):
    if command == "view":
        pytest.skip("runs until it is interrupted")
    as_json, writes = run(command, "--json"), "--out" in WORDS[command]
    assert as_json.code == 0 and "\x1b" not in as_json.out + as_json.told
    numbers = json.loads(as_json.out)
    assert {*KEYS.get(command, ()), "files", "warnings"} <= numbers.keys()
    assert bool(numbers["files"]) == writes and all((inputs / f).exists() for f in numbers["files"])
    verdict = numbers.get("verdict", "none")  # which is among the warnings if it is one
    check_warnings(command, [w for w in numbers["warnings"] if not w.endswith(verdict)])
    check_warnings(command, [line for line in as_json.told.splitlines() if WARNING in line])
