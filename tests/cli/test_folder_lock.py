"""A folder belongs to one process at a time."""

import subprocess
import sys

import pytest

pytestmark = pytest.mark.usefixtures("few_lights")


HOLDING = """
import sys, time
from pathlib import Path
from periscopy_sim.storage.outputs.resume import alone_in
with alone_in(Path("out")):
    print("held", flush=True)
    time.sleep(600)
"""


@pytest.mark.usefixtures("jit")
def test_folder_in_which_another_process_is_at_work_is_refused_until_it_is_killed(
    refused, succeeds, sweep_input, sweep_command
):
    with subprocess.Popen(
        [sys.executable, "-c", HOLDING], cwd=sweep_input, stdout=subprocess.PIPE, text=True
    ) as other:
        try:
            assert other.stdout.readline() == "held\n"
            line = refused(*sweep_command())
        finally:
            other.kill()
    assert line.startswith("another process is at work in out; ")
    succeeds(*sweep_command())
