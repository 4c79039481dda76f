"""`periscopy doctor`: what works on this machine."""

from __future__ import annotations

import os
import platform
import sys
from importlib import metadata

from periscopy_sim.cli.arguments import say


def doctor() -> None:
    """Show versions, which Mitsuba variants work here, and why the others do not."""
    from periscopy_sim.rendering.variant import OVERRIDE, examine_variants, use_variant

    say(f"python       {platform.python_version()} ({sys.executable})")
    for package in ("periscopy-sim", "mitsuba", "drjit", "numpy", "scipy", "numba"):
        say(f"{package:12} {metadata.version(package)}")
    say(f"cores        {os.cpu_count()}")
    for report in examine_variants():
        say(f"{report.name:12} {'works' if report.works else 'does not work'}: {report.reason}")
    if os.environ.get(OVERRIDE):
        say(f"{OVERRIDE} is set to {os.environ[OVERRIDE]}")
    say(f"rendering    with {use_variant()}")
