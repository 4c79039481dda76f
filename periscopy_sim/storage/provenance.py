"""Where a result comes from, and whether a folder's results come from the same.

A folder that one command fills over many runs has a record of what all its results depend on.
"""

import hashlib
import json
import platform
import shlex
from collections.abc import Iterable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from importlib import metadata
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from periscopy_sim.errors import ConfigurationError, OutputError
from periscopy_sim.numerics import Image, validation
from periscopy_sim.rendering import scene_files, variant
from periscopy_sim.scene import SceneDocument
from periscopy_sim.storage.outputs import alone_in, out_of_space_reported, staged_file
from periscopy_sim.storage.places import document

_PACKAGES = ("periscopy-sim", "numpy", "scipy", "mitsuba", "drjit")


def provenance(
    scene: SceneDocument | None, seed: int | None = None, command: Sequence[str] = ()
) -> dict[str, object]:
    """Return what a result was made from, flat and ready for JSON.

    The entries are versions by package, `scene`, `scene_sha256`, `parameters`, Mitsuba's `variant`,
    `seed`, and `command` without ``--out``: results are the same wherever they lie. What there is
    not is None.
    """
    pairs = zip(("", *command), command, strict=False)
    words = [w for before, w in pairs if "--out" not in (before, w) and not w.startswith("--out=")]
    return {
        **{package: metadata.version(package) for package in _PACKAGES},
        "python": platform.python_version(),
        "scene": None if scene is None else str(scene.path),
        "scene_sha256": None if scene is None else scene_sha256(scene),
        "parameters": None if scene is None else dict(scene.given),
        "variant": variant.mi.variant(),
        "seed": seed,
        "command": shlex.join(words),
    }


def as_text(record: Mapping[str, object]) -> dict[str, str]:
    """Return a record as text for the metadata of an image, without its empty entries."""
    return {name: str(value) for name, value in record.items() if value is not None}


def scene_sha256(scene: Path | SceneDocument) -> str:
    """Return the digest of a scene file and of every file that it names, in the text's order.

    The scene's own folder does not matter.
    """
    return sha256_of((scene_files.read_document(scene) if isinstance(scene, Path) else scene).files)


def sha256_of(files: Iterable[Path]) -> str:
    """Return the digest of the contents of files, in their order."""
    digest = hashlib.sha256()
    for file in files:
        try:
            digest.update(
                hashlib.sha256(validation.read_regular(file, validation.MOST_BYTES)).digest()
            )
        except OSError as error:
            raise ConfigurationError(f"{file}: {error.strerror}; check the path") from error
    return digest.hexdigest()


def array_sha256(array: NDArray[Any]) -> str:
    """Return the digest of an array's shape, type and values."""
    state = hashlib.sha256(f"{array.shape} {array.dtype.str}".encode())
    state.update(np.ascontiguousarray(array).data)
    return state.hexdigest()


def image_sha256(image: Image | Mapping[str, Image]) -> Any:
    """Return the digest of a hidden image to single precision; of several images each by its id.

    Its last bits follow how many threads resampled it.
    """
    if isinstance(image, Mapping):
        return {name: image_sha256(each) for name, each in image.items()}
    return array_sha256(image.astype(np.float32))


SETTINGS = "settings.json"
"""File that holds what a folder's results were made with."""


@contextmanager
def resumed_folder(
    out: Path,
    settings: Mapping[str, Any],
    what: str,
    files: Sequence[str],
) -> Iterator[None]:
    """Fill a folder over many runs of the same settings, alone in it.

    A folder of other settings, or with `files`, names or patterns, of unknown settings, is an
    OutputError. Until the first of its files exists, the settings may differ.
    """

    def is_new() -> bool:
        return next(out.glob(files[0]), None) is None

    def check() -> None:
        recorded = document(out / SETTINGS)  # None if it is missing or damaged
        if not is_new() or (recorded is None and any(any(out.glob(name)) for name in files)):
            check_settings(recorded or {}, settings, str(out), what)

    with out_of_space_reported(out):
        check()  # before the folder is made
    with alone_in(out):
        check()
        if is_new():
            with staged_file(out / SETTINGS) as staged:
                staged.write_text(json.dumps(settings, indent=2) + "\n", encoding="utf-8")
        yield


def check_settings(
    recorded: Mapping[str, Any], wanted: Mapping[str, Any], where: str, what: str
) -> None:
    """Raise an `OutputError` if results, `what`, in a folder, `where`, have other settings."""
    if difference := first_difference(recorded, wanted):
        raise OutputError(
            f"{where} holds another {what} ({difference}); name another folder, or remove it to "
            "start anew"
        )


def first_difference(recorded: Mapping[str, Any], wanted: Mapping[str, Any]) -> str:
    """Return the first entry in which settings of JSON's types differ, and both; empty if none."""
    old: Any = recorded
    new: Any = json.loads(json.dumps(wanted))
    path: list[str] = []
    while old != new and isinstance(old, Mapping) and isinstance(new, Mapping):
        path.append(next(name for name in (*new, *old) if old.get(name) != new.get(name)))
        old, new = old.get(path[-1]), new.get(path[-1])
    texts = json.dumps(old), json.dumps(new)
    pairs = enumerate(zip(*texts, strict=False))
    start = max(next((k for k, (a, b) in pairs if a != b), 0) - 16, 0)
    before, after = (f"{'…' if start else ''}{each[start : start + 48]}" for each in texts)
    return f"{'.'.join(path)} {before}, here {after}" if path else ""
