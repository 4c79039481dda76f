import os
import subprocess
import sys
from importlib import metadata

import pytest

from periscopy_sim.rendering.variant import INSTALL_LLVM, examine_variants


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
