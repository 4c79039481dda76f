"""Folders of learning that are filled over several runs, all of the same settings."""

from __future__ import annotations

import hashlib
import json
from collections.abc import Mapping
from pathlib import Path
from typing import Any

from periscopy_sim.errors import OutputError
from periscopy_sim.storage.outputs.resume import check_settings
from periscopy_sim.storage.outputs.staging import staged_file

SETTINGS = "settings.json"


def hold_settings(out: Path, results: str, what: str, settings: Mapping[str, Any]) -> None:
    """Make a folder for results, such as ``*.png``, of these settings alone.

    An OutputError says that it holds results of others, or of which nothing is told.
    """
    out.mkdir(parents=True, exist_ok=True)
    file = out / SETTINGS
    if file.is_file():
        check_settings(json.loads(file.read_text("utf-8")), settings, str(out), what)
    elif next(out.glob(results), None) is not None:
        raise OutputError(f"{out} holds {what} of settings that are not known; name another folder")
    else:
        with staged_file(file) as staged:
            staged.write_text(json.dumps(settings, indent=2) + "\n", encoding="utf-8")


def digest_of(files: list[Path]) -> str:
    """Return the SHA-256 of files, one after the other."""
    found = hashlib.sha256()
    for file in files:
        with file.open("rb") as opened:
            found.update(hashlib.file_digest(opened, "sha256").digest())
    return found.hexdigest()
