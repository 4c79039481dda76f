"""`periscopy doctor`: what works on this machine."""

from __future__ import annotations

import os
import platform
import sys
from importlib import metadata

from periscopy_sim.cli.output import say


def doctor() -> None:
    """Show versions, which Mitsuba variants work here, and why the others do not."""
    from periscopy_sim.rendering.variant import LLVM_FILE, OVERRIDE, examine_variants, use_variant

    say(f"python       {platform.python_version()} ({sys.executable})")
    for package in ("periscopy-sim", "mitsuba", "drjit", "numpy", "scipy", "numba"):
        say(f"{package:12} {metadata.version(package)}")
    say(f"cores        {os.cpu_count()}")
    for report in examine_variants():
        say(f"{report.name:12} {'works' if report.works else 'does not work'}: {report.reason}")
    for name in (LLVM_FILE, OVERRIDE):
        if os.environ.get(name):
            say(f"{name} is set to {os.environ[name]}")
    say(f"rendering    with {use_variant()}")
