"""Outputs that appear complete or not at all, files that grow, folders that one process fills.

Readers find whole arrays and rows of a file that grows at any moment, however its writer ends.
"""

import errno
import glob
import hashlib
import os
import shutil
import sys
import uuid
from collections.abc import Callable, Iterable, Iterator
from contextlib import AbstractContextManager, ExitStack, contextmanager, suppress
from pathlib import Path
from typing import Any

import numpy as np
from numpy.lib import format as npy
from numpy.typing import NDArray

from periscopy_sim.errors import OutputError, path_fault
from periscopy_sim.storage.places import is_remote, original_named, unreachable_reported, uploaded

_FULL = ("requested and", *map(os.strerror, (errno.ENOSPC, errno.EDQUOT, errno.EFBIG)))
"""Words of errors about a full disk or quota: NumPy's, which has no number, and the system's."""


def spare_inputs(outputs: Iterable[Path], inputs: Iterable[Path | None]) -> None:
    """Raise an `OutputError` if an output would replace one of the input files."""
    existing = [file for file in inputs if file is not None and file.exists()]
    for output in outputs:
        with unwritable_reported(output):
            is_given = output.exists() and any(output.samefile(file) for file in existing)
        if is_given:
            raise OutputError(f"cannot write {output}: it is one of the files given; name another")


def staged_file(path: Path) -> AbstractContextManager[Path]:
    """Write a file under a temporary name in the same folder, flush it, and rename it.

    The block receives the temporary name, which has the same suffix. Missing parent folders are
    made and symbolic links followed. If the block raises, the temporary file is removed, and an
    earlier file of that name stays as it was. If the process is killed, the next call with the same
    path removes the temporary file. An `OutputError` on entry says that `path` is a folder or a
    device, or cannot be written; a later one that the disk is full. An object of a store is put
    there at once.
    """
    return _staged(path, Path.touch, Path.is_file, "no regular file; name another")


def staged_folder(path: Path) -> AbstractContextManager[Path]:
    """Fill a folder under a temporary name, and rename it, as `staged_file` does with a file.

    If the folder exists, each file of the new one replaces the file of the same name, one atomic
    rename at a time, and all others stay. The temporary folder then lies inside `path`, which may
    be a mount point. An `OutputError` is raised if a file would replace a folder or vice versa.
    """
    return _staged(path, Path.mkdir, Path.is_dir, "a file; name a folder")


@contextmanager
def _staged(
    path: Path, make: Callable[[Path], None], is_kind: Callable[[Path], bool], other: str
) -> Iterator[Path]:
    """Make a file or a folder under a temporary name, and put it in its place after the block.

    `other` is what else `path` may be, which is an error.
    """
    if is_remote(path):
        with uploaded(path) as staged:
            make(staged)
            yield staged
        return
    with ExitStack() as undo:
        with unwritable_reported(path):
            target = Path(os.path.realpath(path))  # absolute: the block may change folder
            if target.exists() and not is_kind(target):
                raise OutputError(f"cannot write {path}: it is {other}")
            staged = _held(target, make, undo)  # fails before hours of work, if it must
        with out_of_space_reported(path), original_named(path, staged):
            yield staged
        with unwritable_reported(path):
            entries = sorted(staged.rglob("*"))
            for file in filter(Path.is_file, (staged, *entries)):
                with file.open("rb+") as stream:
                    os.fsync(stream.fileno())  # until its content is on the disk
            if not target.is_dir():
                staged.replace(target)
                return
            for entry in entries:
                final = target / entry.relative_to(staged)
                if entry.is_dir():
                    final.mkdir(exist_ok=True)
                else:
                    entry.replace(final)


def _held(target: Path, make: Callable[[Path], None], undo: ExitStack) -> Path:
    """Make and lock a file or folder of a temporary name, and return it.

    Before it is locked another process may take it for a leftover, and remove it.
    """
    while True:
        staged = _temporary_name(target, undo)
        make(staged)
        with suppress(FileNotFoundError):
            if _hold(staged, undo) and staged.exists():
                return staged


def _temporary_name(target: Path, undo: ExitStack) -> Path:
    """Return a new name beside a target, or in it, and remove what killed processes left there.

    The folder is made. `undo` removes the file or folder of that name, which is short, however long
    the target's is.
    """
    folder = target if target.is_dir() else target.parent
    for parent in reversed([each for each in (folder, *folder.parents) if not each.exists()]):
        undo.callback(_remove_empty, parent)
    folder.mkdir(parents=True, exist_ok=True)
    with suppress(FileNotFoundError):
        target.stat()  # shows before hours of work whether there can be such a name
    digest, suffix = hashlib.sha256(os.fsencode(target.name)).hexdigest()[:8], target.suffix[:16]
    for leftover in folder.glob(f".{digest}-????????.partial{glob.escape(suffix)}"):
        with suppress(OSError), ExitStack() as briefly:
            if _hold(leftover, briefly):
                remove(leftover)
    staged = folder / f".{digest}-{uuid.uuid4().hex[:8]}.partial{suffix}"
    undo.callback(remove, staged)
    return staged


def _hold(path: Path, undo: ExitStack) -> bool:
    """Lock a file or folder until `undo`; return whether no other process had."""
    if sys.platform == "win32":  # which renames nothing that is open
        return True
    descriptor = os.open(path, os.O_RDONLY)
    undo.callback(os.close, descriptor)
    return claim(descriptor)


def claim(descriptor: int) -> bool:
    """Lock what is open as long as it is; return whether no other process had.

    Without locks, as on Windows and some file systems, nobody is thought to have.
    """
    if sys.platform != "win32":
        import fcntl

        try:
            fcntl.flock(descriptor, fcntl.LOCK_EX | fcntl.LOCK_NB)
        except BlockingIOError:
            return False
        except OSError:
            pass
    return True


def _remove_empty(folder: Path) -> None:
    """Remove a folder, unless it holds something."""
    with suppress(OSError):
        folder.rmdir()


def remove(path: Path) -> None:
    """Remove a file or a folder, if it exists and the file system can be written."""
    if is_remote(path):
        path.rmdir(recursive=True)  # type: ignore[call-arg] # of universal_pathlib
    elif path.is_dir():
        shutil.rmtree(path, ignore_errors=True)
    else:
        with suppress(OSError):
            path.unlink()


@contextmanager
def unwritable_reported(path: Path) -> Iterator[None]:
    """Raise what is wrong with `path`, by itself or as the system says, as an `OutputError`."""
    if is_remote(path):
        with unreachable_reported(path):
            yield
        return
    try:
        for place in (path, os.path.realpath(path)):
            if fault := path_fault(place):
                raise OutputError(f"cannot write {place}: it {fault}")
        yield
    except (OSError, ValueError) as error:  # ValueError: an OutputError, or a null character
        if isinstance(error, OutputError):
            raise
        reason = getattr(error, "strerror", None) or error
        raise OutputError(f"cannot write {path}: {reason}; choose another place or name") from error


@contextmanager
def out_of_space_reported(path: Path) -> Iterator[None]:
    """Raise a full disk, met while the block writes, as an `OutputError`; of a store any fault."""
    with unreachable_reported(path):
        try:
            yield
        except (OSError, RuntimeError) as error:  # RuntimeError is OpenEXR's
            if not any(words in str(error) for words in _FULL):
                raise
            raise OutputError(f"cannot write {path}: the disk is full; free some space") from error


LOCK = ".lock"
"""File that the process at work holds; it stays, and means nothing by itself."""


@contextmanager
def alone_in(folder: Path) -> Iterator[None]:
    """Keep other processes out of a folder for the duration, however this one ends.

    The folder is made if missing. Another process at work there is an `OutputError`, but for an
    object store: nothing locks that.
    """
    if is_remote(folder):
        yield
        return
    with unwritable_reported(folder):
        folder.mkdir(parents=True, exist_ok=True)
        stream = (folder / LOCK).open("ab")
    with stream:
        if not claim(stream.fileno()):
            raise OutputError(
                f"another process is at work in {folder}; wait for its end, or name another"
            )
        yield


def append_array(path: Path, values: NDArray[np.floating], count: int) -> None:
    """Add float32 values to a stack of `count` arrays, an NPY file; at 0 in place of a former one.

    The header, whose length NumPy keeps while the first axis grows, counts an array once its values
    are written. An OutputError says that the file cannot be written.
    """
    header: dict[str, Any] = {"descr": "<f4", "fortran_order": False}
    if not count:
        with unwritable_reported(path):
            path.write_bytes(b"")
    with unwritable_reported(path), path.open("r+b") as file:
        if not count:
            npy.write_array_header_1_0(file, {**header, "shape": (0, *values.shape)})
        file.seek(0, 2)
        file.write(np.ascontiguousarray(values, "<f4").tobytes())
        file.flush()
        file.seek(0)
        npy.write_array_header_1_0(file, {**header, "shape": (count + 1, *values.shape)})
