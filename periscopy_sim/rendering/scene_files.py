"""The files of a scene, read before Mitsuba reads them: its XML, the files it names, its meshes.

This is the only reader of which files belong to a scene: rendering, digests and copies ask here. It
searches as Mitsuba 3.9 does (`mi.load_file`), but for the folder that the process started in. An
included file and a spectrum are found where the tag stands: beside the documents that include it,
then in the ``<path>`` folders so far, the latest first; Mitsuba searches an include beside its own
document first. What plugins read (meshes, textures, volumes) is found when all is parsed: in the
scene's ``<path>`` folders, the latest first, then beside the scene.

Mesh files of any format become arrays, and PLY for Mitsuba, which reads no STL and GLB.
trimesh reads these, Mitsuba PLY and OBJ. What both let pass in silence is checked here: a file cut
short, vertices that are not finite, indices of no vertex, polygons with a notch, which they would
fill, and what trimesh skips of GLB.
"""

import hashlib
import io
import json
import logging
import re
import uuid
import xml.etree.ElementTree as ET
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from functools import cache, lru_cache
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any

import numpy as np
from numpy.typing import NDArray

from periscopy_sim.errors import SceneError, printable
from periscopy_sim.numerics.validation import LARGEST, MOST_BYTES, number_of, read_regular
from periscopy_sim.rendering.variant import mi, one_line, without_warnings
from periscopy_sim.scene import SceneDocument

FOREIGN = ("stl", "glb")
"""Formats, by the ending of a file's name, that Mitsuba does not read and trimesh does."""

FORMATS = (*FOREIGN, "obj", "ply")

REMEDY = "export it as triangles in STL or, where UV coordinates count, in binary PLY"
"""What makes any mesh file one that is read."""

OBJ_LINES = {b"v", b"vt", b"vn", b"f", b"l", b"p", b"o", b"g", b"s", b"mg", b"mtllib", b"usemtl",
             b"maplib", b"usemap", b"lod", b"bevel", b"c_interp", b"d_interp"}  # fmt: skip
"""Lines of an OBJ file that hold triangles, polygons, or nothing that casts a shadow; a line that
a backslash continues begins with none of these words."""

UNREAD = re.compile(
    rb'"(?:EXT_mesh\w+|KHR_draco_\w+|KHR_mesh_\w+|extensionsRequired|targets|sparse|skins)"'
    rb'|"normalized"\s*:\s*true|"mode"\s*:\s*[0-35-9]'
)
"""Geometry in the document of a GLB file that trimesh skips or takes for another: extensions, morph
targets, bones, sparse and normalized numbers, and modes other than triangles."""


SIDES = 128
"""Sides of the polygon for a circle: its width is right to 2e-4, a thin rod's A to 1e-5."""


@dataclass(frozen=True, eq=False)
class TriangleMesh:
    """Triangles: vertices (V, 3) in the file's unit, faces (F, 3) of them, and UV (V, 2) or None.

    v runs up, as Mitsuba has it.
    """

    vertices: NDArray[np.float64]
    faces: NDArray[np.int64]
    texture_coordinates: NDArray[np.float64] | None = None


@cache
def revolved(outline: tuple[tuple[float, float], ...]) -> TriangleMesh:
    """Return the closed mesh of an outline, (radius, z) from axis to axis, about the z axis.

    The polygons of its circles have the circles' mean width.
    """
    import trimesh

    # The mean over all directions of a convex outline's width is its length over pi.
    wide = (np.pi / SIDES) / np.sin(np.pi / SIDES)
    solid = trimesh.creation.revolve(np.multiply(outline, (wide, 1)), sections=SIDES)
    return TriangleMesh(np.asarray(solid.vertices), np.asarray(solid.faces))


def read_mesh(path: Path, kind: str | None = None) -> TriangleMesh:
    """Return the triangles of a mesh file, of one of `FORMATS`: None is the one its name ends in.

    Polygons become triangles, and the parts of a GLB file one mesh, each where the file has it.
    Axes and unit are the file's own. What is wrong is a ValueError in words that follow its name.
    """
    kind = kind or path.suffix[1:].lower()
    if kind not in FORMATS:
        raise ValueError(f"is of no known format; give {', '.join(map(str.upper, FORMATS))}")
    content = _content(path)
    check_mesh(path, kind)
    announced = _announced(content, kind)
    mesh = _concatenated(_parts(content, kind))
    if announced is not None and len(mesh.faces) < announced:
        raise ValueError(f"is cut short: it has {len(mesh.faces)} faces of {announced}")
    _check_arrays(mesh)
    return mesh


def check_mesh(path: Path, plugin: str) -> None:
    """Check that Mitsuba reads a ``ply`` or ``obj`` file, with faces of its vertices.

    What is wrong is a ValueError. The mesh itself must not outlive this: Dr.Jit traces every one at
    the next virtual call.
    """
    if plugin in ("ply", "obj"):
        _check_unchanged(path, plugin, path.stat().st_mtime_ns)


@lru_cache(maxsize=256)
def _check_unchanged(path: Path, plugin: str, _: int) -> None:
    """Check a mesh file, once as of a time: the lines of a large OBJ file take a second."""
    content = _content(path)
    head = content.partition(b"end_header")[0]
    counts = re.findall(rb"^\s*element\s+\S+\s+([0-9]+)", head, re.MULTILINE)
    if plugin == "ply" and sum(map(int, counts)) > len(content):
        raise ValueError("is cut short: it announces more than it holds")
    try:
        # Flat first: Mitsuba follows a wrong index to the vertex normals, out of its memory.
        with without_warnings():  # which come when the scene is loaded
            mesh = mi.load_dict({"type": plugin, "filename": str(path), "face_normals": True})
    except RuntimeError as error:
        raise ValueError(f"cannot be read ({one_line(error)})") from None
    buffers = mesh.vertex_positions_buffer(), mesh.faces_buffer()
    vertices, faces = (np.array(each).reshape(-1, 3) for each in buffers)
    del mesh, buffers
    _check_arrays(TriangleMesh(vertices, faces))
    if plugin == "obj":
        _check_lines(content)


def _content(path: Path) -> bytes:
    try:
        content = read_regular(path, MOST_BYTES)
    except OSError as error:
        raise ValueError(error.strerror) from None
    if not content:
        raise ValueError("is empty")
    return content


def write_ply(path: Path, mesh: TriangleMesh) -> None:
    """Write a mesh as a binary PLY file, in single precision, as Mitsuba keeps it."""
    import trimesh

    uv = mesh.texture_coordinates
    visual = None if uv is None else trimesh.visual.TextureVisuals(uv=uv)
    written = trimesh.Trimesh(mesh.vertices, mesh.faces, visual=visual, process=False)
    path.write_bytes(written.export(file_type="ply", vertex_normal=False))


def as_ply(path: Path, kind: str) -> Path:
    """Return a PLY file of what a mesh file of a format holds; it lasts as long as this process.

    What is wrong is a ValueError, see `read_mesh`.
    """
    return _copy(path, kind, hashlib.sha256(_content(path)).digest())


@lru_cache(maxsize=256)
def _copy(path: Path, kind: str, _: bytes) -> Path:
    """Write a mesh file as PLY, once for its content."""
    mesh = read_mesh(path, kind)
    copy = Path(_copies().name) / f"{uuid.uuid4().hex}.ply"
    write_ply(copy, mesh)
    return copy


@cache
def _copies() -> TemporaryDirectory[str]:
    """Return this process's folder of copies."""
    return TemporaryDirectory(prefix="periscopy-meshes-")


def _document_end(content: bytes) -> int:
    """Return where the document of a GLB file, which begins at 20, ends."""
    return 20 + int.from_bytes(content[12:16], "little")


def _announced(content: bytes, kind: str) -> int | None:
    """Return how many faces a file announces, if its format does; reject one that is cut short."""
    if kind == "glb":
        if int.from_bytes(content[8:12], "little") != len(content):
            raise ValueError("is cut short, or no GLB file")
        if feature := UNREAD.search(content, 20, _document_end(content)):
            what = feature[0].decode().replace('"', "")
            raise ValueError(f"has what is not supported ({what})")
    if kind != "stl":
        return None
    count = int.from_bytes(content[80:84], "little")
    if len(content) == 84 + 50 * count:
        return count
    if not content.lstrip().startswith(b"solid") or b"endsolid" not in content[-200:]:
        raise ValueError("is cut short, or no STL file")
    return len(re.findall(rb"^\s*facet\b", content, re.M))


def _check_lines(content: bytes) -> None:
    """Reject what Mitsuba skips of an OBJ file, and polygons that no fan of triangles fills."""
    lines = [line.split() for line in re.sub(rb"#.*", b"", content).splitlines() if line.strip()]
    if skipped := {line[0] for line in lines} - OBJ_LINES:
        raise ValueError(f"has lines of {min(skipped).decode(errors='replace')!r}")
    vertices = np.array([line[1:4] for line in lines if line[0] == b"v"], np.float64)
    faces = [[c.split(b"/")[0] for c in line[1:]] for line in lines if line[0] == b"f"]
    for size in {len(face) for face in faces if len(face) > 3}:
        alike = np.array([face for face in faces if len(face) == size], np.int64)
        side = vertices[alike[:, 1:] - 1] - vertices[alike[:, :1] - 1]  # from the first corner
        fan = np.cross(side[:, :-1], side[:, 1:])
        area, most = fan.sum(axis=1, keepdims=True), np.linalg.norm(fan, axis=2).sum(axis=1)
        back = np.sum(fan * area, axis=2).min(axis=1) < -1e-6 * most**2
        if (back | (np.linalg.norm(area[:, 0], axis=1) < 1e-3 * most)).any():
            raise ValueError("has a polygon with a notch, or one that crosses itself")


def _parts(content: bytes, kind: str) -> list[TriangleMesh]:
    """Return what a file holds of triangles, each part placed as the file says."""
    import trimesh

    logging.getLogger("trimesh").setLevel(logging.CRITICAL + 1)  # which logs what it tries in vain
    try:
        if kind == "glb":  # trimesh makes zeros of what is in no buffer
            accessors = json.loads(content[20 : _document_end(content)]).get("accessors", [])
            if any(each["count"] > len(content) for each in accessors):
                raise ValueError("it announces more than it holds")
        scene = trimesh.load_scene(io.BytesIO(content), file_type=kind, process=False)
        return [
            _placed(scene.geometry[name], np.asarray(to_scene, np.float64))
            for to_scene, name in map(scene.graph.get, sorted(scene.graph.nodes_geometry))
            if isinstance(scene.geometry[name], trimesh.Trimesh)
        ]
    except Exception as error:  # trimesh raises whatever its readers meet
        reason = " ".join(str(error).split())[:200]
        raise ValueError(f"cannot be read ({type(error).__name__}: {reason})") from None


def _placed(part: Any, to_scene: NDArray[np.float64]) -> TriangleMesh:
    with np.errstate(invalid="ignore"):  # `_check_arrays` rejects what is not finite
        vertices = np.asarray(part.vertices, np.float64) @ to_scene[:3, :3].T + to_scene[:3, 3]
    faces = np.asarray(part.faces, np.int64)
    if np.linalg.det(to_scene[:3, :3]) < 0:  # mirrored: the outside stays outside
        faces = faces[:, ::-1]
    uv = getattr(part.visual, "uv", None)
    return TriangleMesh(vertices, faces, None if uv is None else np.asarray(uv, np.float64))


def _concatenated(parts: list[TriangleMesh]) -> TriangleMesh:
    """Return several meshes as one; it has UV where all have."""
    if not parts:
        raise ValueError("has no faces")
    starts = np.cumsum([0, *(len(part.vertices) for part in parts[:-1])])
    uv = [part.texture_coordinates for part in parts if part.texture_coordinates is not None]
    return TriangleMesh(
        np.concatenate([part.vertices for part in parts]),
        np.concatenate([part.faces + start for part, start in zip(parts, starts, strict=True)]),
        np.concatenate(uv) if len(uv) == len(parts) else None,
    )


def _check_arrays(mesh: TriangleMesh) -> None:
    """Reject a mesh without faces, with faces of no vertex, or with numbers that are not finite."""
    count, uv = len(mesh.vertices), mesh.texture_coordinates
    if not len(mesh.faces):
        raise ValueError("has no faces")
    wrong = mesh.faces[(mesh.faces < 0) | (mesh.faces >= count)]
    if wrong.size:
        raise ValueError(f"has a face of vertex {wrong[0]}, of {count} from 0 on")
    with np.errstate(over="ignore"):
        finite = np.isfinite(mesh.vertices.astype(np.float32)).all()
    if not finite or (uv is not None and not (len(uv) == count and np.isfinite(uv).all())):
        raise ValueError("has vertices or texture coordinates that are no finite numbers")


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
