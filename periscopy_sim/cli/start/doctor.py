"""`periscopy doctor`: versions, extras and variants on this machine."""

from __future__ import annotations

import os
import platform
import sys
from importlib import metadata
from importlib.util import find_spec

from periscopy_sim.cli.output import say
from periscopy_sim.extras import SWEEP
from periscopy_sim.rendering.variant import LLVM_FILE, OVERRIDE, examine_variants, use_variant

EXTRAS_OF = {
    "sweep": SWEEP, "dataset": SWEEP, "raw": ("rawpy",), "tags": ("cv2",),
    "torch": (*SWEEP, "torch"),
    "deepinv": (*SWEEP, "torch", "deepinv"),
    "live": ("viser",), "video": ("av",),
}  # fmt: skip
"""The modules that each extra brings."""


def doctor() -> None:
    """Show versions, missing extras and Mitsuba variants."""
    say(f"python       {platform.python_version()} ({sys.executable})")
    for package in ("periscopy-sim", "mitsuba", "drjit", "numpy", "scipy", "numba"):
        say(f"{package:12} {metadata.version(package)}")
    for extra, modules in EXTRAS_OF.items():
        lacking = ", ".join(module for module in modules if find_spec(module) is None)
        state = f"not installed (lacks {lacking}): pip install -e '.[{extra}]'"
        say(f"{f'[{extra}]':12} {state if lacking else 'installed'}")
    say(f"cores        {os.cpu_count()}")
    for report in examine_variants():
        say(f"{report.name:12} {'works' if report.works else 'does not work'}: {report.reason}")
    for name in (LLVM_FILE, OVERRIDE):
        if os.environ.get(name):
            say(f"{name} is set to {os.environ[name]}")
    say(f"rendering    with {use_variant()}")
