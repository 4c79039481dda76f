"""Folders that are filled over many runs: by one process at a time, all of the same settings."""

from __future__ import annotations

import json
from collections.abc import Iterable, Iterator, Mapping
from contextlib import contextmanager
from pathlib import Path
from typing import Any

from periscopy_sim.errors import OutputError
from periscopy_sim.storage.outputs.staging import claim, staged_file

SETTINGS = "settings.json"
"""File that holds what a folder's results were made with."""

LOCK = ".lock"
"""File that the process at work holds; it stays, and means nothing by itself."""


@contextmanager
def alone_in(folder: Path) -> Iterator[None]:
    """Keep other processes out of a folder for the duration, however this one ends.

    The folder is made if missing. Another process at work there is an `OutputError`.
    """
    try:
        folder.mkdir(parents=True, exist_ok=True)
        stream = (folder / LOCK).open("ab")
    except OSError as error:
        raise OutputError(f"cannot write {folder}: {error.strerror}; name another") from error
    with stream:
        if not claim(stream.fileno()):
            raise OutputError(
                f"another process is at work in {folder}; wait for its end, or name another"
            )
        yield


def read_settings(folder: Path) -> dict[str, Any] | None:
    """Return what a folder's results were made with; None if it has no such record."""
    file = folder / SETTINGS
    try:
        return dict(json.loads(file.read_text("utf-8")))
    except FileNotFoundError:
        return None
    except (ValueError, TypeError, OSError):
        raise OutputError(f"{file}: is damaged; name another folder") from None


def write_settings(folder: Path, settings: Mapping[str, Any]) -> None:
    """Write down what all that follows in a folder is made with."""
    with staged_file(folder / SETTINGS) as staged:
        staged.write_text(json.dumps(settings, indent=2) + "\n", encoding="utf-8")


def refuse_results(folder: Path, results: Iterable[str]) -> None:
    """Raise if a folder holds results, files by name or pattern, without a record of settings."""
    for file in (file for pattern in results for file in folder.glob(pattern)):
        raise OutputError(f"{file}: nothing tells what it was made with; name another folder")


def check_settings(
    held: Mapping[str, Any], wanted: Mapping[str, Any], where: str, what: str
) -> None:
    """Raise if results have other settings; the message names the first entry that differs.

    Settings are of JSON's types. Messages call what holds the results `where`, a folder, and the
    results `what`, a sweep.
    """
    there: Any = held
    here: Any = json.loads(json.dumps(wanted))
    path: list[str] = []
    while there != here and isinstance(there, Mapping) and isinstance(here, Mapping):
        path.append(next(name for name in (*here, *there) if there.get(name) != here.get(name)))
        there, here = there.get(path[-1]), here.get(path[-1])
    if path:
        raise OutputError(
            f"{where} holds another {what} ({'.'.join(path)} {json.dumps(there)[:48]}, here "
            f"{json.dumps(here)[:48]}); name another folder, or remove it to start anew"
        )
