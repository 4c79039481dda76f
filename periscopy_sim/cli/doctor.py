"""`periscopy doctor`: versions, extras and variants on this machine."""

import os
import platform
import sys
from importlib import metadata
from importlib.util import find_spec

from periscopy_sim.cli.output import conclude, record, show_table
from periscopy_sim.extras import EXTRA_OF, installation
from periscopy_sim.rendering.variant import OVERRIDE, examine_variants, is_vectorized, use_variant


def doctor() -> None:
    """Show versions, missing extras and Mitsuba variants."""
    rows = {"python": f"{platform.python_version()} ({sys.executable})"}
    for package in ("periscopy-sim", "mitsuba", "drjit", "numpy", "scipy", "numba"):
        rows[package] = metadata.version(package)
    for extra in dict.fromkeys(EXTRA_OF.values()):
        modules = [module for module, brought_by in EXTRA_OF.items() if brought_by == extra]
        lacking = ", ".join(module for module in modules if find_spec(module) is None)
        state = f"not installed (lacks {lacking}): {installation(extra)}"
        rows[f"[{extra}]"] = state if lacking else "installed"
    rows["cores"] = str(os.cpu_count())
    for report in examine_variants():
        rows[report.name] = f"{'works' if report.works else 'does not work'}: {report.reason}"
    if os.environ.get(OVERRIDE):
        rows[OVERRIDE] = os.environ[OVERRIDE]
    show_table(rows.items())
    record(**rows)
    variant = use_variant()
    conclude(f"rendering with {variant}", "green" if is_vectorized() else "yellow")
