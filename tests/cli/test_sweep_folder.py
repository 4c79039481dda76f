"""What a sweep takes up in its folder, and what it refuses there."""

import signal
import subprocess
import sys

import numpy as np
import pytest

from periscopy_sim.cli.light import TransportRequest

pytestmark = pytest.mark.usefixtures("few_lights")


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
def test_sweep_killed_twice_ends_in_the_same_bytes(
    succeeds, sweep_input, sweep_command, sweep_results
):
    succeeds(*sweep_command(out="whole"))
    # In the midst of the matrix, and among the results.
    for writes in (3, 50):
        code = KILLED.format(writes=writes, arguments=sweep_command())
        ended = subprocess.run([sys.executable, "-c", code], cwd=sweep_input, capture_output=True)
        assert ended.returncode == -signal.SIGKILL, ended.stderr
        assert not (sweep_input / "out" / "sweep.csv").exists()
    marks = list((sweep_input / "out/sweep.zarr/making/finished").glob("*.json"))
    assert 0 < len(marks) < 16
    succeeds(*sweep_command())
    assert sweep_results(sweep_input / "out") == sweep_results(sweep_input / "whole")


@pytest.mark.usefixtures("jit")
def test_folder_of_another_sweep_is_refused_before_rendering(
    monkeypatch, succeeds, refused, sweep_input, sweep_command
):
    succeeds(*sweep_command())
    np.save(sweep_input / "other.npy", np.load(sweep_input / "y.npy") + 1)
    monkeypatch.setattr(TransportRequest, "matrix", None)
    for change, key in [
        (("--methods", "preconditioned"), "methods"),
        (("--seed", "1"), "base_seed"),
        (("--photograph", "other.npy"), "photograph"),
        (("--samples", "5"), "samples"),
        (("-D", "occluder_dx=0.001"), "parameters.occluder_dx"),
    ]:
        line = refused(*sweep_command(), *change)
        assert line.startswith(f"out holds another sweep ({key} "), change


@pytest.mark.usefixtures("jit")
def test_own_method_that_changed_is_another_sweep(succeeds, refused, sweep_input, sweep_command):
    command = sweep_command(methods="mine.py:Mine", sbr="1")
    succeeds(*command)
    with (sweep_input / "mine.py").open("a") as stream:
        stream.write("\n# changed\n")
    assert "out holds another sweep (methods" in refused(*command)


@pytest.mark.usefixtures("jit")
def test_method_that_cannot_be_fitted_is_named_and_can_be_corrected(
    refused, periscopy, succeeds, sweep_input, sweep_command
):
    outcome = periscopy(*sweep_command(methods="mine.py:Unfit"))
    assert outcome.code == 2 and "'mine.py:Unfit' cannot be fitted: KeyError" in outcome.err
    assert refused(*sweep_command(), "--samples", "5").startswith(
        "out holds another sweep (samples "
    )
    matrix = (sweep_input / "out" / "A.npy").stat().st_mtime_ns
    # Whatever does not bear upon the matrix may be another.
    succeeds(*sweep_command(methods="mine.py:Mine", sbr="2", snr=50, ambient="lamp.exr"))
    assert (sweep_input / "out" / "A.npy").stat().st_mtime_ns == matrix


def test_files_of_unknown_origin_are_not_taken_up(refused, sweep_input, sweep_command):
    (sweep_input / "out").mkdir()
    (sweep_input / "out" / "A.npy").write_text("old")
    assert "out holds A.npy" in refused(*sweep_command())
