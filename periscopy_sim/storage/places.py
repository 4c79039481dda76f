"""Where results go: a path on this machine, or an object store such as ``s3://bucket/name``.

Object stores have neither renames nor locks. They need none: an object appears whole or not at all.
"""

import json
import os
import uuid
from collections.abc import Callable, Iterable, Iterator
from concurrent.futures import ThreadPoolExecutor
from contextlib import contextmanager, suppress
from itertools import islice
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any, TypeVar, cast
from urllib.request import url2pathname

from periscopy_sim.errors import OutputError, PeriscopyError, require
from periscopy_sim.numerics.validation import read_json

Item = TypeVar("Item")
Answer = TypeVar("Answer")

AT_ONCE, BATCH = 32, 1024
"""Requests of an object store that wait at once, and those taken from a list at a time."""


class SharedFolder(type(Path())):  # type: ignore[misc] # Python 3.11 makes no `Path` of a subclass
    """A folder that machines share, as ``file:///shared``: workers write there themselves."""


def place(name: str | Path) -> Path:
    """Return a path, or of a URL that fsspec opens what has pathlib's interface.

    A PeriscopyError says that its library is missing, or that there is no such kind of URL.
    """
    protocol, is_url, rest = str(name).rstrip("/").partition("://")
    if not is_url or isinstance(name, Path):
        return Path(name) if isinstance(name, str) else name
    if (protocol := protocol.lower()) in ("file", "local"):
        host, _, below = rest.partition("/")
        if host not in ("", "localhost"):
            raise PeriscopyError(f"{name}: names the machine {host}; write file:///FOLDER")
        return cast(Path, SharedFolder(url2pathname(f"/{below}")))
    upath = require("upath")
    try:
        # Other processes write, too: what a store lists is asked for again.
        options: dict[str, Any] = {"use_listings_cache": False}
        if protocol in ("s3", "s3a"):  # it would ask for the size of all that it reads
            options["max_concurrency"] = 1
        found = upath.UPath(f"{protocol}://{rest}", **options)
        found.fs  # noqa: B018, which looks for the library
    except Exception as error:  # whatever a library misses in a URL
        raise PeriscopyError(f"{name}: nothing here opens {protocol}://: {error}") from error
    return cast(Path, found)


def user_cache() -> Path:
    """Return the folder of what is kept for later commands, wherever they write.

    It is ``PERISCOPY_DATA`` if this variable of the environment is set, else the user's cache.
    """
    import pooch

    return Path(os.environ.get("PERISCOPY_DATA") or pooch.os_cache("periscopy_sim"))


def is_remote(path: Path) -> bool:
    """Return whether a place is an object store."""
    return not isinstance(path, Path)


def is_shared(path: Path) -> bool:
    """Return whether workers on all machines reach a place."""
    return is_remote(path) or isinstance(path, SharedFolder)


def address(path: Path) -> dict[str, Any]:
    """Return a place as Zarr and xarray take it, as their arguments."""
    if not is_remote(path):
        return {"store": path}
    found: Any = path
    return {"store": str(path), "storage_options": dict(found.storage_options)}


def content(path: Path) -> bytes:
    """Return the bytes of a file or an object; a FileNotFoundError says that there is none."""
    if not is_remote(path):
        return path.read_bytes()
    found: Any = path
    with unreachable_reported(path, FileNotFoundError):
        return bytes(found.fs.cat_file(found.path))


def document(path: Path) -> Any:
    """Return what a JSON file or object holds; None if there is none, or it is damaged."""
    try:
        return json.loads(content(path)) if is_remote(path) else read_json(path)
    except OutputError:
        raise
    except (OSError, ValueError):
        return None


def put(path: Path, data: bytes) -> None:
    """Write a file or an object, whole or not at all; `staged_file` waits for the disk besides."""
    if is_remote(path):
        found: Any = path
        with unreachable_reported(path):
            found.fs.pipe_file(found.path, data)
    else:
        path.parent.mkdir(parents=True, exist_ok=True)
        staged = path.with_name(f".{uuid.uuid4().hex[:8]}.partial")
        staged.write_bytes(data)
        staged.replace(path)


def clear(path: Path) -> None:
    """Remove a file or an object, if it is there."""
    found: Any = path
    with unreachable_reported(path), suppress(FileNotFoundError):
        found.fs.rm_file(found.path) if is_remote(path) else path.unlink()


def names_in(folder: Path) -> list[str]:
    """Return the names of what a folder holds, of objects 1,000 a request; none without it."""
    found: Any = folder
    if not is_remote(folder):
        return [each.name for each in folder.glob("*")]
    with unreachable_reported(folder), suppress(FileNotFoundError):
        return [each.rsplit("/", 1)[-1] for each in found.fs.ls(found.path, detail=False)]
    return []


@contextmanager
def unreachable_reported(path: Path, *but: type[Exception]) -> Iterator[None]:
    """Raise what a store's library raises, but for some errors, as an `OutputError`."""
    try:
        yield
    except Exception as error:
        if not is_remote(path) or isinstance(error, (PeriscopyError, *but)):
            raise
        reason = " ".join(str(error).split()) or type(error).__name__
        raise OutputError(f"cannot use {path}: {reason}; mend that, and begin again") from error


@contextmanager
def original_named(path: Path, copy: Path) -> Iterator[None]:
    """Let errors name a place instead of its copy on this machine."""
    try:
        yield
    except PeriscopyError as error:
        error.args = (str(error).replace(str(copy), str(path)),)
        raise


def answers(path: Path, ask: Callable[[Item], Answer], items: Iterable[Item]) -> Iterator[Answer]:
    """Yield what a function returns of items, as `map`; an object store is asked many at once."""
    if not is_remote(path):
        yield from map(ask, items)
        return
    left = iter(items)
    with ThreadPoolExecutor(AT_ONCE) as threads:
        while some := [*islice(left, BATCH)]:
            yield from threads.map(ask, some)


@contextmanager
def uploaded(path: Path) -> Iterator[Path]:
    """Write a file or fill a folder on this machine, which then goes to a store.

    What belongs to a folder is uploaded in the order of its names.
    """
    with TemporaryDirectory() as folder:
        staged = Path(folder) / (path.name or "staged")
        with original_named(path, staged):
            yield staged
        files = [each for each in sorted(staged.rglob("*")) if each.is_file()]
        for file in files or [staged]:
            target = path / file.relative_to(staged).as_posix() if files else path
            put(target, file.read_bytes())
