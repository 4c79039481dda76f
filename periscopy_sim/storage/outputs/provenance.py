"""Where a result comes from: versions, scene, variant, seed and command."""

from __future__ import annotations

import hashlib
import platform
import shlex
from collections.abc import Iterator, Mapping, Sequence
from importlib import metadata
from pathlib import Path
from string import Template
from xml.etree import ElementTree

from periscopy_sim.errors import SceneError

_PACKAGES = ("periscopy-sim", "numpy", "scipy", "mitsuba", "drjit")


def provenance(
    scene: Path | None,
    variant: str | None,
    seed: int | None,
    command: Sequence[str],
    parameters: Mapping[str, str] | None = None,
) -> dict[str, object]:
    """Record what a result was made from, ready for JSON.

    Parameters
    ----------
    scene : Path or None
        The scene file, if there is one.
    variant : str or None
        The Mitsuba variant, if one was used.
    seed : int or None
        The seed of the random draws, if there were any.
    command : sequence of str
        The command line, program first. Where the result lies is left out of the record.
    parameters : mapping or None
        Values given for the scene's defaults.

    Returns
    -------
    dict
        Flat: the versions of this package, NumPy, SciPy, Mitsuba, Dr.Jit and Python under their
        names, then `scene`, `scene_sha256`, `variant`, `seed` and `command`; None where there is
        none.

    Raises
    ------
    SceneError
        As `scene_sha256`.
    """
    return {
        **{package: _version(package) for package in _PACKAGES},
        "python": platform.python_version(),
        "scene": None if scene is None else _printable(str(scene)),
        "scene_sha256": None if scene is None else scene_sha256(scene, parameters),
        "variant": variant,
        "seed": seed,
        "command": _printable(shlex.join(_without_output(command))),
    }


def as_text(record: Mapping[str, object]) -> dict[str, str]:
    """Text of a record for the metadata of an image, without its empty entries."""
    return {name: str(value) for name, value in record.items() if value is not None}


def scene_sha256(scene: Path, parameters: Mapping[str, str] | None = None) -> str:
    """Digest of a scene file and of every file it refers to.

    These are its `filename` strings and includes, theirs in turn, in the order of the document
    and relative to its folder or the scene's, with its defaults, or the parameters given instead,
    filled in. Files that do not exist are skipped. The scene's own folder does not matter.

    Raises
    ------
    SceneError
        If a scene file cannot be read or is not well-formed XML.
    """
    digest = hashlib.sha256()
    for path in _scene_files(scene, scene.parent, set(), parameters or {}):
        with path.open("rb") as stream:
            digest.update(hashlib.file_digest(stream, "sha256").digest())
    return digest.hexdigest()


def _scene_files(
    document: Path, folder: Path, seen: set[Path], parameters: Mapping[str, str]
) -> Iterator[Path]:
    """Yield a scene document, then each existing file it refers to, each file once."""
    seen.add(document.resolve())
    try:
        root = ElementTree.fromstring(document.read_bytes())
    except (OSError, ElementTree.ParseError, LookupError, ValueError) as error:
        raise SceneError(f"{document}: cannot be read as a scene: {error}; mend the XML") from error
    yield document
    for name, included in _references(root, parameters):
        found = next((p for p in (document.parent / name, folder / name) if p.is_file()), None)
        if found is None or found.resolve() in seen:
            continue
        if included:
            yield from _scene_files(found, folder, seen, parameters)
        else:
            seen.add(found.resolve())
            yield found


def _references(
    root: ElementTree.Element, parameters: Mapping[str, str]
) -> Iterator[tuple[str, bool]]:
    """File names in a scene document, and whether each is an included document."""
    defaults = {e.get("name", ""): e.get("value", "") for e in root.iter("default")}
    defaults |= parameters
    for element in root.iter():
        if element.tag == "include":
            name = element.get("filename")
        elif element.tag == "string" and element.get("name") == "filename":
            name = element.get("value")
        else:
            continue
        if name:
            yield Template(name).safe_substitute(defaults), element.tag == "include"


def _version(package: str) -> str:
    """Version of an installed package, without importing it."""
    try:
        return metadata.version(package)
    except metadata.PackageNotFoundError:
        return "not installed"


def _without_output(command: Sequence[str]) -> Iterator[str]:
    """Yield a command line but for its `--out`, so that results are the same wherever they lie."""
    words = iter(command)
    for word in words:
        if word == "--out":
            next(words, None)
        elif not word.startswith("--out="):
            yield word


def _printable(text: str) -> str:
    """Text with undecodable bytes of file names spelled out, so that every format can hold it."""
    return text.encode("utf-8", "backslashreplace").decode("utf-8")
