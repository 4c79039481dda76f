"""The folder of a sweep: what it holds, and the settings that all of it belongs to."""

from __future__ import annotations

import json
from collections.abc import Mapping
from pathlib import Path
from typing import Any

from periscopy_sim.errors import OutputError
from periscopy_sim.storage.outputs.resume import check_settings
from periscopy_sim.storage.outputs.staging import staged_file

SETTINGS = "settings.json"
RENDERED = ("A.npy", "photograph.exr", "ambient")
STORE = "sweep.zarr"
RESULTS = (STORE, "sweep.csv", "sweep.png", "seconds.csv")
VARIED = ("ambient", "ambient_prototypes", "flips", "methods", "monitor_off", "sbr", "snr", "seeds")
"""Settings that nothing rendered follows from: they may change until there are results."""


def check_folder(out: Path, settings: Mapping[str, Any]) -> None:
    """Refuse a folder of other settings, or with files that are not known to be of these.

    Until there are results, what is varied may differ from what the folder was made for.
    """
    file = out / SETTINGS
    if file.is_file():
        try:
            held = dict(json.loads(file.read_text("utf-8")))
        except (ValueError, TypeError, OSError):
            raise OutputError(f"{file}: is damaged; name another folder") from None
        if not (out / STORE).exists():
            held |= {name: settings[name] for name in VARIED}
        check_settings(held, settings, str(out), "sweep")
        return
    for name in (*RENDERED, *RESULTS):
        if (out / name).exists():
            raise OutputError(
                f"{out} holds {name} but no {SETTINGS} that tells of what; name another folder"
            )


def claim_folder(out: Path, settings: Mapping[str, Any]) -> None:
    """Write down what all that follows in the folder belongs to."""
    check_folder(out, settings)  # again, now that nobody else writes there
    if not (out / STORE).exists():
        with staged_file(out / SETTINGS) as staged:
            staged.write_text(json.dumps(settings, indent=2) + "\n", "utf-8")
