"""What a scenario made, kept by all that it depends on: in memory, and in folders."""

import hashlib
from collections import OrderedDict
from collections.abc import Callable, Hashable
from contextlib import suppress
from dataclasses import dataclass, fields, is_dataclass
from functools import cache, partial
from importlib import metadata
from itertools import accumulate
from pathlib import Path
from threading import RLock
from typing import Any, Self, TypeVar, cast

import numpy as np

from periscopy_sim.errors import PeriscopyError, PhotographError
from periscopy_sim.numerics.machine import available_memory
from periscopy_sim.storage import outputs, places, provenance, rasters

Made = TypeVar("Made")

MOST_BYTES, SHARE = 1 << 31, 0.25
"""Bytes that a memo keeps by default, and the fraction of the machine's memory that they are at
most: A of 30 scenes of 126 x 126 pixels and 29 x 36 patches."""

LIGHT_BYTES = 1 << 28
"""Bytes of ambient light in the user's cache: some 1,400 photographs of 126 x 126 pixels."""

RENDERING = "rendering/**/*.py", "analytic/*.py", "scenario.py", "memo.py"
"""The code on which the content of an `ArrayFolder` depends; it changes more often than its
version."""


class Memo:
    """Makes a thing once, and returns it whenever the same key comes again.

    In memory the least recently used things make room before another is made, so that both need not
    fit; the latest one stays, whatever its size. A folder, if one is given, keeps what is rendered
    for other processes, too. Two threads make things in turn: Dr.Jit's arrays belong to one thread
    at a time. A copy, and what pickle restores, has the folder and an empty memory.
    """

    def __init__(self, most_bytes: int | None = None, folder: str | Path | None = None) -> None:
        if most_bytes is None:
            available = available_memory() or MOST_BYTES / SHARE
            most_bytes = min(MOST_BYTES, int(SHARE * available))
        self.most_bytes = most_bytes
        self.folder = None if folder is None else ArrayFolder(Path(folder))
        self._kept: OrderedDict[Hashable, tuple[Any, int]] = OrderedDict()
        self._lock = RLock()

    def get(
        self,
        key: Hashable,
        make: Callable[[], Made],
        size: int = 0,
        kind: type[Any] | None = None,
        cache: "ArrayFolder | None" = None,
    ) -> Made:
        """Return what `make` makes, of about `size` bytes; that of before if the key is the same.

        Its arrays become read-only. What `make` raises is not kept. Folders, the memo's own and a
        `cache`, keep what is of a `kind`: an array, or a dataclass of arrays and numbers.
        """
        with self._lock:
            if key in self._kept:
                self._kept.move_to_end(key)
            else:
                held = sum(each for _, each in self._kept.values())
                for other, (_, bytes_of) in [*self._kept.items()]:
                    if held + size <= self.most_bytes:
                        break
                    if bytes_of:
                        del self._kept[other]
                        held -= bytes_of
                if kind is not None:
                    for folder in self._folders(cache):
                        make = partial(folder.get, key, make, kind)
                self._kept[key] = make(), size
                for each in _arrays_of(self._kept[key][0]).values():
                    if isinstance(each, np.ndarray):
                        each.setflags(write=False)
            made: Made = self._kept[key][0]
            return made

    def holds(self, key: Hashable, cache: "ArrayFolder | None" = None) -> bool:
        """Return whether `get` returns what was made before, unless a file is damaged."""
        return key in self._kept or any(each.file(key).is_file() for each in self._folders(cache))

    def _folders(self, cache: "ArrayFolder | None") -> "list[ArrayFolder]":
        return [each for each in (cache, self.folder) if each is not None]

    def __reduce__(self) -> tuple[type[Self], tuple[int, Path | None]]:
        """Leave out what is in memory: a worker makes its own."""
        return type(self), (self.most_bytes, self.folder.path if self.folder else None)


@dataclass(frozen=True)
class ArrayFolder:
    """A folder that keeps arrays, in a file for each key, and for each version of the renderer.

    `most_bytes` makes it a cache: those used longest ago go beyond them, and where it cannot be
    written nothing is kept. Else it keeps all, and a full disk is an OutputError. A file that is
    damaged is made anew. Processes may share a folder.
    """

    path: Path
    most_bytes: int | None = None

    def file(self, key: Hashable) -> Path:
        """Return the file of a key, whose parts are texts, numbers and dataclasses of these."""
        from periscopy_sim.rendering.variant import mi

        record = repr((key, mi.variant(), _renderer()))
        return self.path / f"{hashlib.sha256(record.encode()).hexdigest()}.npz"

    def get(self, key: Hashable, make: Callable[[], Made], kind: type[Made]) -> Made:
        """Return what the key's file holds, else what `make` makes, which the file gets."""
        file = self.file(key)
        if file.is_file():
            with suppress(PhotographError):
                found = _read(file, kind)
                with suppress(OSError):
                    file.touch()  # the latest is removed last
                return found
        if self.most_bytes is None:
            with outputs.staged_file(file) as staged:  # tries the place before hours of work
                np.savez(staged, **_arrays_of(made := make()))
            return made
        made = make()
        with suppress(PeriscopyError, OSError):
            with outputs.staged_file(file) as staged:
                np.savez(staged, **_arrays_of(made))
            held = [(each.stat(), each) for each in self.path.glob("[!.]*")]
            held.sort(key=lambda each: each[0].st_mtime_ns, reverse=True)
            for (_, each), total in zip(held, accumulate(s.st_size for s, _ in held), strict=True):
                if total > self.most_bytes:
                    each.unlink(missing_ok=True)
        return made


def light_cache() -> ArrayFolder:
    """Return the user's cache of ambient light, which is slow to render and the same for many."""
    return ArrayFolder(places.user_cache() / "ambient", LIGHT_BYTES)


def _read(file: Path, kind: type[Made]) -> Made:
    """Return what a file of `_arrays_of` holds; a PhotographError says that it is damaged."""
    with rasters.decoding(file, "NPZ"), file.open("rb") as stream, np.load(stream) as archive:
        held = {name: archive[name] for name in archive.files}
        if kind is np.ndarray:
            return cast(Made, held["array"])
        return kind(**{name: each if each.ndim else each.item() for name, each in held.items()})


def _arrays_of(made: Any) -> dict[str, Any]:
    """Return an array, or the fields of a dataclass that are arrays or numbers, by name."""
    if not is_dataclass(made):
        return {"array": made} if isinstance(made, np.ndarray) else {}
    values = {each.name: getattr(made, each.name) for each in fields(made) if each.compare}
    return {n: each for n, each in values.items() if isinstance(each, np.ndarray | float | int)}


@cache
def _renderer() -> tuple[str, ...]:
    """Return the digest of the code that renders and keeps, and the versions of its libraries."""
    package = Path(__file__).parent
    files = [file for part in RENDERING for file in sorted(package.glob(part))]
    return provenance.sha256_of(files), *map(metadata.version, ("mitsuba", "drjit"))
