"""Mesh files of any format, as arrays, and as PLY for Mitsuba, which reads no STL, GLB or OFF.

trimesh reads them. What it lets pass is checked here: a file cut short where a line or a triangle
ends, numbers that are not finite, and indices of no vertex.
"""

from __future__ import annotations

import hashlib
import io
import json
import logging
import os
import re
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from functools import cache
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any

import numpy as np
from numpy.typing import NDArray

from periscopy_sim.rendering.scene.meshes import check_mesh
from periscopy_sim.rendering.variant import use_variant

FOREIGN = ("stl", "glb", "off")
"""Formats, by the ending of a file's name, that Mitsuba does not read and trimesh does."""

FORMATS = (*FOREIGN, "obj", "ply")


MOST_FACES = 20_000_000
"""Triangles of a file, its repeated parts counted each time."""


@dataclass(frozen=True, eq=False)
class TriangleMesh:
    """Triangles: vertices (V, 3) in the file's unit, faces (F, 3) of them, and UV (V, 2) or None.

    v runs up, as Mitsuba has it.
    """

    vertices: NDArray[np.float64]
    faces: NDArray[np.int64]
    texture_coordinates: NDArray[np.float64] | None = None


def read_mesh(path: Path, kind: str | None = None) -> TriangleMesh:
    """Return the triangles of a mesh file, of one of `FORMATS`: None is the one its name ends in.

    Polygons become triangles, and the parts of a GLB file one mesh, each where the file has it.
    Axes and unit are the file's own. What is wrong is a ValueError in words that follow its name.
    """
    kind = kind or path.suffix[1:].lower()
    if kind not in FORMATS:
        raise ValueError(f"is of no known format; give {', '.join(map(str.upper, FORMATS))}")
    content = path.read_bytes()
    if not content:
        raise ValueError("is empty")
    if kind in ("obj", "ply"):
        use_variant()
        try:
            check_mesh(path, kind)
        except RuntimeError as error:
            reason = " ".join(str(error).split())[-200:]
            raise ValueError(f"cannot be read (... {reason})") from None
    announced = _triangles_of_stl(content) if kind == "stl" else None
    if kind == "off":
        _check_off(content)
    if kind == "glb":
        _check_glb(content)
    mesh = _checked(_concatenated(_parts(content, kind)))
    if announced not in (None, len(mesh.faces)):
        raise ValueError(f"announces {announced} triangles and holds {len(mesh.faces)}")
    return mesh


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
    digest = hashlib.sha256(kind.encode() + path.read_bytes()).hexdigest()
    copy = Path(_copies().name) / f"{digest}.ply"
    if not copy.is_file():
        mesh = read_mesh(path, kind)
        begun = copy.with_suffix(f".{os.getpid()}")
        write_ply(begun, mesh)
        begun.replace(copy)
    return copy


@cache
def _copies() -> TemporaryDirectory[str]:
    """Return this process's folder of copies: who calibrates reads a scene hundreds of times."""
    return TemporaryDirectory(prefix="periscopy-meshes-")


# -- reading -------------------------------------------------------------------------------------


def _parts(content: bytes, kind: str) -> list[TriangleMesh]:
    """Return what a file holds of triangles, each part placed as the file says."""
    import trimesh

    try:
        with _in_silence():
            scene = trimesh.load_scene(io.BytesIO(content), file_type=kind, process=False)
            placed = [
                (scene.geometry[name], to_scene)
                for to_scene, name in map(scene.graph.get, sorted(scene.graph.nodes_geometry))
                if isinstance(scene.geometry[name], trimesh.Trimesh)
            ]
            faces = sum(len(part.faces) for part, _ in placed)
            if faces > MOST_FACES:
                raise ValueError(f"{faces} triangles, more than {MOST_FACES}")
            return [_placed(part, np.asarray(matrix, np.float64)) for part, matrix in placed]
    except Exception as error:  # trimesh raises whatever its readers meet
        reason = " ".join(str(error).split())[:200]
        raise ValueError(f"cannot be read ({type(error).__name__}: {reason})") from None


@contextmanager
def _in_silence() -> Iterator[None]:
    """Keep trimesh from logging what it tries in vain."""
    logger, handler = logging.getLogger("trimesh"), logging.NullHandler()
    before, logger.propagate = logger.propagate, False
    logger.addHandler(handler)
    try:
        yield
    finally:
        logger.removeHandler(handler)
        logger.propagate = before


def _placed(part: Any, to_scene: NDArray[np.float64]) -> TriangleMesh:
    with np.errstate(invalid="ignore"):  # `_checked` refuses what is not finite
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


def _checked(mesh: TriangleMesh) -> TriangleMesh:
    """Return a mesh that is one, or refuse it."""
    count, uv = len(mesh.vertices), mesh.texture_coordinates
    if not len(mesh.faces):
        raise ValueError("has no faces")
    wrong = mesh.faces[(mesh.faces < 0) | (mesh.faces >= count)]
    if wrong.size:
        raise ValueError(f"has a face of vertex {wrong[0]}, of {count} from 0 on")
    with np.errstate(over="ignore"):
        single = mesh.vertices.astype(np.float32)
    if not np.isfinite(single).all():
        raise ValueError("has vertices that are no finite numbers")
    if uv is not None and (len(uv) != count or not np.isfinite(uv).all()):
        raise ValueError("has texture coordinates that are no finite numbers")
    return mesh


def _triangles_of_stl(content: bytes) -> int:
    """Return how many triangles an STL file announces; refuse one that is cut short."""
    binary = int.from_bytes(content[80:84], "little")
    if len(content) >= 84 and len(content) == 84 + 50 * binary:
        return binary
    if not content.lstrip().startswith(b"solid") or b"\0" in content:
        raise ValueError(
            f"is cut short, or no STL file: {binary} triangles take {84 + 50 * binary} bytes, it "
            f"has {len(content)}"
        )
    try:
        text = content.decode()
    except UnicodeDecodeError:
        raise ValueError("is no text in UTF-8, nor a whole binary STL file") from None
    begun, ended = (len(re.findall(rf"^\s*{word}\b", text, re.M)) for word in ("solid", "endsolid"))
    if begun != ended:
        raise ValueError("is cut short: its last solid does not end")
    return len(re.findall(r"^\s*facet\b", text, re.M))


def _check_off(content: bytes) -> None:
    """Refuse an OFF file that has fewer rows than its header announces, or other numbers."""
    try:
        text = content.decode()
    except UnicodeDecodeError:
        raise ValueError("is no text in UTF-8; save OFF as text") from None
    rows = [row for line in text.splitlines() if (row := line.partition("#")[0].split())]
    match rows:
        case [[name], [vertices, faces, *_], *body] if name.endswith("OFF"):
            pass
        case [[name, vertices, faces, *_], *body] if name.endswith("OFF"):
            pass
        case _:
            raise ValueError("has no OFF header")
    if not (re.fullmatch("[0-9]{1,9}", vertices) and re.fullmatch("[0-9]{1,9}", faces)):
        raise ValueError(f"has '{vertices} {faces}' in its header for vertices and faces")
    wanted = int(vertices) + int(faces)
    if len(body) < wanted:
        raise ValueError(f"is cut short: {len(body)} rows of {wanted}")
    for row in body[int(vertices) : wanted]:
        if not re.fullmatch("[0-9]{1,9}", row[0]) or len(row) <= int(row[0]) or int(row[0]) < 3:
            raise ValueError(f"has the face '{' '.join(row)[:60]}', which lacks corners")


def _check_glb(content: bytes) -> None:
    """Refuse a GLB file that announces more numbers than it has bytes: they would be allocated."""
    try:
        length = int.from_bytes(content[12:16], "little")
        accessors = json.loads(content[20 : 20 + length]).get("accessors", [])
        most = max((accessor["count"] for accessor in accessors), default=0)
    except (ValueError, LookupError, TypeError, AttributeError, RecursionError):
        raise ValueError("has no GLB header, or a damaged one") from None
    if most > len(content):
        raise ValueError(f"is cut short: it should hold an array of {most} entries")
