"""Outputs that appear complete under their final name, or not at all."""

from __future__ import annotations

import errno
import hashlib
import os
import re
import shutil
import socket
import uuid
from collections.abc import Iterable, Iterator
from contextlib import ExitStack, contextmanager, suppress
from functools import cache
from itertools import count
from pathlib import Path
from typing import Any

from periscopy_sim.errors import OutputError

OUT_OF_SPACE = frozenset({errno.ENOSPC, errno.EDQUOT, errno.EFBIG})
"""Error numbers of a disk, or of a quota of it, that takes no more."""

_MACHINE_ID = Path("/etc/machine-id")
_CUT_SHORT = re.compile(r"\d+ requested and \d+ written")
"""What NumPy says where the disk takes no more; it keeps no error number."""


def spare_inputs(outputs: Iterable[Path], inputs: Iterable[Path | None]) -> None:
    """Refuse outputs that would replace what they are made from, by an `OutputError`."""
    given = [file for file in inputs if file is not None and file.exists()]
    for output in outputs:
        if output.exists() and any(output.samefile(file) for file in given):
            raise OutputError(f"cannot write {output}: it is one of the files given; name another")


@contextmanager
def staged_file(path: Path) -> Iterator[Path]:
    """Write a file under a temporary name, and rename it once it is complete.

    Missing parent folders are made, symbolic links followed. If the block raises, nothing of the
    file or of those folders remains, and a file that stood there before is untouched. The block is
    given a free name with the same suffix in the same folder. An `OutputError` is raised on entry
    if `path` is a folder or a device, or its folder cannot be written; later, if the disk is full.
    """
    with ExitStack() as undo:
        with _reported(path):
            target = Path(os.path.realpath(path))  # absolute: the block may change folder
            if target.is_dir():
                raise OutputError(f"cannot write {path}: it is a folder; name a file inside it")
            if target.exists() and not target.is_file():
                raise OutputError(f"cannot write {path}: it is not a regular file; name another")
            _make_folder(target.parent, undo)
            staged = undo.enter_context(_own_name(target, target.parent))
            staged.touch(exist_ok=False)  # proves now, not after hours, that it can be written
            staged.unlink()
        with out_of_space_reported(path):
            yield staged
        with _reported(path):
            staged.replace(target)


@contextmanager
def staged_folder(path: Path) -> Iterator[Path]:
    """Fill a folder under a temporary name, as `staged_file` does a file.

    Where the folder exists already, each file of the new one replaces its namesake, one atomic
    rename at a time, and all others are kept. The block is given an empty folder: beside `path`, or
    inside it where `path` exists, since that may be a mount point, across which files cannot be
    renamed. It is an `OutputError`, too, if a file would replace a folder or a folder a file.
    """
    with ExitStack() as undo:
        with _reported(path):
            target = Path(os.path.realpath(path))
            if target.exists() and not target.is_dir():
                raise OutputError(f"cannot write {path}: it is a file; name a folder")
            home = target if target.is_dir() else target.parent
            _make_folder(home, undo)
            with _own_name(target, target.parent):
                pass  # now what a process that was killed left beside the folder is gone, too
            staged = undo.enter_context(_own_name(target, home))
            staged.mkdir()
        with out_of_space_reported(path):
            yield staged
        with _reported(path):
            if target.is_dir():
                _merge(staged, target)
            else:
                staged.rename(target)


@contextmanager
def _own_name(target: Path, home: Path) -> Iterator[Path]:
    """Yield a free hidden name in a folder, with the target's suffix, for this process alone.

    The names of a target are numbered. Each is locked by the process that stages under it, so that
    what lies under one that is not locked was left by a process that was killed, and is removed.
    Names bear the host: what another one stages on a shared disk is left alone.
    """
    from filelock import FileLock, Timeout

    own: tuple[Path, FileLock] | None = None
    for number in count():
        staged = home / f".{target.stem[:40]}-{_host()}-{number}{target.suffix}"
        lock = FileLock(f"{staged}.lock", timeout=0)
        if own is not None and not os.path.lexists(staged):
            break
        try:
            lock.acquire()
        except Timeout:
            continue
        except (OSError, NotImplementedError):  # a file system without locks, or not writable
            staged = staged.with_name(f".{target.stem[:40]}-{uuid.uuid4().hex}{target.suffix}")
            own = own or (staged, lock)
            break
        _remove(staged)
        if own is None:
            own = staged, lock
        else:
            _give_up(lock)
    assert own is not None
    try:
        yield own[0]
    finally:
        _remove(own[0])  # before another process may take the name
        _give_up(own[1])


def _remove(staged: Path) -> None:
    """Remove a file or a folder, if it is there."""
    if staged.is_dir() and not staged.is_symlink():
        shutil.rmtree(staged, ignore_errors=True)
    else:
        staged.unlink(missing_ok=True)


def _give_up(lock: Any) -> None:
    """Release a lock of `_own_name`, and remove its file: who waits for it sees that it is gone."""
    if lock.is_locked:
        with suppress(OSError):  # where open files cannot be removed
            Path(lock.lock_file).unlink()
        lock.release()


@cache
def _host() -> str:
    """Return what tells this machine from others that write to the same disk.

    Not `uuid.getnode`: without a network interface it is another number in every process.
    """
    machine = b""
    with suppress(OSError):  # not every system has one
        machine = _MACHINE_ID.read_bytes()
    return hashlib.sha256(socket.gethostname().encode() + b" " + machine).hexdigest()[:8]


def _make_folder(folder: Path, undo: ExitStack) -> None:
    """Make a folder and its missing parents; `undo` removes those that stay empty."""
    if folder.is_dir():
        return
    if folder.exists():
        raise NotADirectoryError(errno.ENOTDIR, f"{folder} is not a folder")
    _make_folder(folder.parent, undo)
    folder.mkdir(exist_ok=True)
    undo.callback(_remove_if_empty, folder)


def _remove_if_empty(folder: Path) -> None:
    with suppress(OSError):
        folder.rmdir()


def _merge(staged: Path, target: Path) -> None:
    """Move every file of `staged` over its namesake in `target`, keeping all others."""
    entries = sorted(staged.rglob("*"))
    for entry in entries:
        final = target / entry.relative_to(staged)
        if final.exists() and final.is_dir() != entry.is_dir():
            kind = "folder" if final.is_dir() else "file"
            raise OutputError(f"cannot write {final}: a {kind} of that name exists; remove it")
    for entry in entries:
        final = target / entry.relative_to(staged)
        if entry.is_dir():
            final.mkdir(exist_ok=True)
        else:
            entry.replace(final)
    shutil.rmtree(staged)


@contextmanager
def _reported(path: Path) -> Iterator[None]:
    """Raise what the system says against `path` as an `OutputError`."""
    try:
        yield
    except OutputError:
        raise
    except (OSError, ValueError) as error:  # ValueError: a path with a null character
        reason = getattr(error, "strerror", None) or error
        raise OutputError(f"cannot write {path}: {reason}; choose another place") from error


@contextmanager
def out_of_space_reported(path: Path) -> Iterator[None]:
    """Raise a full disk, met while the block writes, as an `OutputError`."""
    try:
        yield
    except (OSError, RuntimeError) as error:  # the latter is OpenEXR's
        if reason := _why_out_of_space(error):
            raise OutputError(f"cannot write {path}: {reason}; free some space") from error
        raise


def _why_out_of_space(error: OSError | RuntimeError) -> str:
    """Return what the system says of a full disk; empty where the error is another."""
    if _CUT_SHORT.search(str(error)):
        return os.strerror(errno.ENOSPC)
    reasons = {number: os.strerror(number) for number in OUT_OF_SPACE}
    told = [text for text in reasons.values() if text in str(error)]
    return reasons.get(getattr(error, "errno", None) or 0, told[0] if told else "")
