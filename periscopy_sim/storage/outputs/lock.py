"""One process at a time in a folder that a command fills over many runs."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

from periscopy_sim.errors import OutputError

LOCK = ".lock"
"""File that the process at work holds; it stays, and means nothing by itself."""


@contextmanager
def alone_in(folder: Path) -> Iterator[None]:
    """Keep other processes out of a folder for the duration, however this one ends.

    The folder is made if missing. Another process at work there is an `OutputError`.
    """
    from filelock import FileLock, Timeout

    lock = FileLock(folder / LOCK, timeout=0)
    try:
        folder.mkdir(parents=True, exist_ok=True)
        (folder / LOCK).touch()
    except OSError as error:
        raise OutputError(
            f"cannot write {folder}: {error.strerror}; choose another place"
        ) from error
    try:
        lock.acquire()
    except Timeout:
        raise OutputError(
            f"another process is at work in {folder}; wait for its end or name another folder"
        ) from None
    except (OSError, NotImplementedError):  # a file system without locks
        pass
    try:
        yield
    finally:
        lock.release()
