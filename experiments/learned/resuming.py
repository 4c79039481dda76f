"""Folders of learning that are filled over several runs, all of the same settings."""

from __future__ import annotations

import hashlib
from collections.abc import Mapping
from pathlib import Path
from typing import Any

from periscopy_sim.storage.outputs.resume import resumed_folder


def hold_settings(out: Path, results: str, what: str, settings: Mapping[str, Any]) -> None:
    """Make a folder for results, such as ``*.png``, of these settings alone.

    An OutputError says that the folder holds results of other or of unknown settings.
    """
    with resumed_folder(out, settings, what, [results]):
        pass


def digest_of(files: list[Path]) -> str:
    """Return the SHA-256 of files, one after the other."""
    found = hashlib.sha256()
    for file in files:
        with file.open("rb") as opened:
            found.update(hashlib.file_digest(opened, "sha256").digest())
    return found.hexdigest()
