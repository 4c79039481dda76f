"""The XML of a scene file, read before Mitsuba reads it: its defaults and the files that it names.

This is the only reader of which files belong to a scene: rendering, digests and copies ask here. It
searches as Mitsuba 3.9 does (`mi.load_file`), but for the folder that the process started in. An
included file and a spectrum are found where the tag stands: beside the documents that include it,
then in the ``<path>`` folders so far, the latest first; Mitsuba searches an include beside its own
document first. What plugins read (meshes, textures, volumes) is found when all is parsed: in the
scene's ``<path>`` folders, the latest first, then beside the scene.
"""

import io
import re
import xml.etree.ElementTree as ET
from collections.abc import Callable, Mapping, Sequence
from functools import lru_cache
from pathlib import Path
from typing import Any

from periscopy_sim.errors import SceneError, printable
from periscopy_sim.numerics.limits import LARGEST, number_of, read_regular
from periscopy_sim.rendering.scene.mesh_formats import FOREIGN, FORMATS, REMEDY, as_ply, check_mesh
from periscopy_sim.scene import SceneDocument

MOST = {
    "elements within each other": 50,  # of some 10,000 Mitsuba's parser leaves the stack
    "elements": 100_000,  # Mitsuba builds a scene of as many shapes in 15 s
    "characters when filled in": 10_000,  # values may name each other in a row
}
"""What a scene may have at most, with all that its documents include."""

Element = tuple[int, str, Mapping[str, str]]
"""A document's element: its level below the first one, its tag and its attributes."""


def read_document(path: str | Path, parameters: Mapping[str, str] | None = None) -> SceneDocument:
    """Return what a scene file and those that it includes declare, with values for ``<default>``s.

    An unchanged file is parsed once in a process. A file that does not exist, is no regular file or
    no XML, includes itself or exceeds the limits above is a `SceneError`.
    """
    path, given = Path(path), dict(parameters or {})
    reader, folders = _Reader(path, given), [path.parent]
    reader.read(path, folders, (), 0)
    files: dict[Path, Path] = {}
    for named in reader.named:
        file = _first(named, folders) if isinstance(named, str) else named
        if file is not None:
            files.setdefault(file.resolve(), file)
    lists = tuple(files.values()), tuple(folders), tuple(reader.missing)
    return SceneDocument(path, given, reader.defaults, *lists, reader.units)


def check_values(document: SceneDocument) -> None:
    """Reject values that a scene does not declare or that are out of range, and missing files."""
    path = document.path
    for name in document.given:
        if name not in document.defaults:
            raise document.undeclared(name)
    if document.missing:  # Mitsuba looks where the process started, too, and would open a pipe
        raise SceneError(f"scene '{path}' names a missing file '{document.missing[0]}'")
    for name, text in document.values.items():
        if not all(map(_is_in_range, text.replace(",", " ").split())):
            raise SceneError(
                f"scene '{path}': parameter '{name}' is '{text[:80]}'; give finite numbers, to "
                f"{LARGEST:g}"
            )


@lru_cache(maxsize=4096)
def _is_in_range(word: str) -> bool:
    """Return whether a word of a parameter is a number in range, or no number at all."""
    return not abs(number_of(word)) > LARGEST and word.lower().strip("+-") != "nan"


def file_of(props: Any, document: SceneDocument) -> tuple[str, Path]:
    """Return a plugin and the file that it reads: of a mesh that Mitsuba does not read, a copy."""
    name, plugin = props["filename"], props.plugin_name()
    where = f"scene '{document.path}': {plugin}" + (f" '{props.id()}'" if props.id() else "")
    file = _first(name, document.folders)
    if file is None:
        raise SceneError(f"{where} names a missing file '{document.path.parent / name}'")
    if file.stat().st_size == 0:
        raise SceneError(f"{where} names an empty file '{file}'")
    kind = file.suffix[1:].lower()
    try:
        if plugin in FOREIGN or (plugin in ("ply", "obj") and kind in FOREIGN):
            return "ply", as_ply(file, kind if kind in FORMATS else plugin)
        check_mesh(file, plugin)
    except ValueError as error:
        raise SceneError(f"{where}: the file '{file}' {error}; {REMEDY}") from None
    return plugin, file


class _Reader:
    """A walk through a scene's documents in the order of their text, as Mitsuba parses them."""

    def __init__(self, scene: Path, parameters: Mapping[str, str]) -> None:
        self._where = f"scene '{scene}'"
        self._values: dict[str, str] = {}
        for name, value in parameters.items():
            self._set(name, value)
        self.defaults: dict[str, str] = {}
        self.named: list[Path | str] = []
        """Files in order, and names that plugins look for once all is parsed."""
        self.missing: list[str] = []
        self.units: dict[str, str] = {}
        self._count = 0

    def read(
        self, document: Path, folders: list[Path], including: tuple[Path, ...], depth: int
    ) -> None:
        """Read a document, and those that it includes; its ``<path>`` tags join the folders.

        Its own first element is at a level of `depth`.
        """
        identity = document.resolve()
        if identity in including:
            raise SceneError(f"{self._where}: '{document.name}' includes itself; leave that out")
        self.named.append(document)
        elements = _parsed(document)
        self._count += len(elements)
        self._check_count(self._count, "elements")
        for below, tag, texts in elements:
            self._check_count(depth + below, "elements within each other")
            varies = "$" in "".join(texts.values())
            attributes = texts  # which the cache shares: nothing may change them
            if varies:
                attributes = {name: self._filled(text) for name, text in texts.items()}
            match tag, attributes:
                case "default", {"name": name, "value": value}:
                    self.defaults.setdefault(name, value)
                    self._set(name, value)
                case "path", {"value": name}:
                    folders[:0] = self._found(name, [document.parent, *folders], Path.exists)
                case "include", {"filename": name}:
                    nearer = [document.parent, *folders]
                    for included in self._found(name, nearer):
                        self.read(included, nearer, (*including, identity), depth + below + 1)
                case "spectrum", {"filename": name}:
                    self.named += self._found(name, folders)
                case "string", {"name": "filename", "value": name}:
                    self.named.append(name)
                case "rotate" | "translate" | "lookat", _ if varies:
                    names = re.findall(r"\$(\w+)", " ".join(texts.values()))
                    self.units |= dict.fromkeys(names, "degrees" if tag == "rotate" else "m")

    def _found(
        self, name: str, folders: Sequence[Path], kind: Callable[[Path], bool] = Path.is_file
    ) -> list[Path]:
        """Return the first file of a name, alone, or nothing, and note that it is missing."""
        path = _first(name, folders, kind)
        if path is None:
            self.missing.append(name)
        return [] if path is None else [path]

    def _set(self, name: str, value: str) -> None:
        """Take a parameter's value, unless it has one: the first counts."""
        if "$" in value:
            raise SceneError(
                f"{self._where}: '{name}' has the value '{value[:80]}', whose '$' no parameter "
                "before it fills in"
            )
        self._values.setdefault(name, value)

    def _filled(self, text: str) -> str:
        """Fill the values of parameters in, the longest names first, but for an escaped dollar."""
        if "$" not in text:
            return text
        values, references = self._values, _references(tuple(self._values))
        length = len(text) + sum(len(values[name]) for name in references.findall(text))
        self._check_count(length, "characters when filled in", f": '{text[:40]}'")
        return references.sub(lambda match: values[match[1]], text).replace("\\$", "$")

    def _check_count(self, count: int, what: str, text: str = "") -> None:
        if count > MOST[what]:
            raise SceneError(f"{self._where}{text} has more than {MOST[what]} {what}; give fewer")


def literal(text: str) -> str:
    """Return text as a scene holds it in which no parameter is to be filled in."""
    return text.replace("$", "\\$")


def comment(text: str) -> str:
    """Return text as a comment of a scene may hold it."""
    return re.sub("-(?=-)", "- ", printable(text))


@lru_cache(maxsize=64)
def _references(names: tuple[str, ...]) -> re.Pattern[str]:
    """Return the pattern of a reference to one of some parameters, the longest name that fits."""
    either = "|".join(map(re.escape, sorted(names, key=len, reverse=True))) or "(?!)"
    return re.compile(rf"(?<!\\)\$({either})")


def _first(
    name: str, folders: Sequence[Path], kind: Callable[[Path], bool] = Path.is_file
) -> Path | None:
    """Return the first file of a name, or whatever else exists of it, in the folders."""
    for folder in folders:
        try:
            if kind(folder / name):
                return folder / name
        except (OSError, ValueError):  # no file system has such a name
            return None
    return None


def _parsed(path: Path) -> tuple[Element, ...]:
    """Return the elements of an XML file, in order."""
    if not path.exists():
        raise SceneError(f"no scene file at '{path}'")
    try:
        return _elements(read_regular(path))
    except (OSError, ValueError) as error:
        reason = getattr(error, "strerror", None) or error
        raise SceneError(f"scene '{path}' cannot be read: {reason}") from None
    except (ET.ParseError, LookupError) as error:
        raise SceneError(f"scene '{path}' is not well-formed XML: {error}") from None


@lru_cache(maxsize=64)
def _elements(content: bytes) -> tuple[Element, ...]:
    depth, elements = 0, []
    for event, element in ET.iterparse(io.BytesIO(content), ("start", "end")):
        if event == "end":
            depth -= 1
            continue
        elements.append((depth, str(element.tag), element.attrib))
        depth += 1
    return tuple(elements)
