"""`periscopy doctor`: versions, extras and variants on this machine."""

import os
import platform
import sys
from importlib import metadata
from importlib.util import find_spec

from periscopy_sim.cli.output import say
from periscopy_sim.extras import EXTRA_OF, installation
from periscopy_sim.rendering.variant import OVERRIDE, examine_variants, use_variant


def doctor() -> None:
    """Show versions, missing extras and Mitsuba variants."""
    say(f"python       {platform.python_version()} ({sys.executable})")
    for package in ("periscopy-sim", "mitsuba", "drjit", "numpy", "scipy", "numba"):
        say(f"{package:12} {metadata.version(package)}")
    for extra in dict.fromkeys(EXTRA_OF.values()):
        modules = [module for module, brought_by in EXTRA_OF.items() if brought_by == extra]
        lacking = ", ".join(module for module in modules if find_spec(module) is None)
        state = f"not installed (lacks {lacking}): {installation(extra)}"
        say(f"{f'[{extra}]':12} {state if lacking else 'installed'}")
    say(f"cores        {os.cpu_count()}")
    for report in examine_variants():
        say(f"{report.name:12} {'works' if report.works else 'does not work'}: {report.reason}")
    if os.environ.get(OVERRIDE):
        say(f"{OVERRIDE} is set to {os.environ[OVERRIDE]}")
    say(f"rendering    with {use_variant()}")
