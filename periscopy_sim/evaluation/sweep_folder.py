"""The folder of a sweep: what it holds, and the settings that all of it belongs to."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from typing import Any

from periscopy_sim.storage.outputs.resume import (
    check_settings,
    read_settings,
    refuse_results,
    write_settings,
)

RENDERED = ("A.npy", "photograph.exr", "ambient")
STORE = "sweep.zarr"
RESULTS = (STORE, "sweep.csv", "sweep.png", "seconds.csv")
VARIED = ("ambient", "ambient_prototypes", "flips", "methods", "monitor_off", "sbr", "snr", "seeds")
"""Settings that nothing rendered follows from: they may change until there are results."""


def check_folder(out: Path, settings: Mapping[str, Any]) -> None:
    """Refuse a folder of other settings, or with files that are not known to be of these.

    Until there are results, what is varied may differ from what the folder was made for.
    """
    held = read_settings(out)
    if held is None:
        refuse_results(out, (*RENDERED, *RESULTS))
        return
    if not (out / STORE).exists():
        held |= {name: settings[name] for name in VARIED}
    check_settings(held, settings, str(out), "sweep")


def claim_folder(out: Path, settings: Mapping[str, Any]) -> None:
    """Write down what all that follows in the folder belongs to."""
    check_folder(out, settings)  # again, now that nobody else writes there
    if not (out / STORE).exists():
        write_settings(out, settings)
