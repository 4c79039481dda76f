"""Mesh files, read by Mitsuba's own reader, and checked for what it lets pass.

Of the damaged PLY and OBJ files of the tests Mitsuba 3.9.1 refuses most by itself. But it allocates
what a header announces, follows an index beyond the vertices out of its memory, takes a negative
one for 0, leaves faces out that it cannot read, and keeps normals that are not finite: that is
checked here. (trimesh 5.2 with checks of its arrays would let eleven of those files pass, refuse
three sound ones, and take 1.2 s to import.)
"""

from __future__ import annotations

import io
import math
import re
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

_LONGEST_HEADER = 1 << 16  # bytes
_NUMBERS = {
    "char": "i1", "int8": "i1", "uchar": "u1", "uint8": "u1", "short": "i2", "int16": "i2",
    "ushort": "u2", "uint16": "u2", "int": "i4", "int32": "i4", "uint": "u4", "uint32": "u4",
    "float": "f4", "float32": "f4", "double": "f8", "float64": "f8",
}  # fmt: skip


def check_mesh(path: Path, plugin: str) -> None:
    """Check that a mesh file is whole, its numbers finite and its indices those of its vertices.

    `plugin` is Mitsuba's name of its format; others than ``ply`` and ``obj`` are not looked into.
    What is wrong is a ValueError in these words, or a RuntimeError in Mitsuba's.
    """
    if plugin not in ("ply", "obj"):
        return
    content = path.read_bytes()
    properties = _announced(content) if plugin == "ply" else []
    for flat in (True, False):  # a wrong index is followed only to normals that are not flat
        indices, vertices, others = _read(path, plugin, flat)
        if not len(indices):
            raise ValueError("has no faces")
        if indices.max() >= vertices:
            raise ValueError(f"has a face of vertex {indices.max()}, of {vertices} from 0 on")
    faces = len(indices) // 3
    if plugin == "obj":
        if (count := _triangles(content)) != faces:
            raise ValueError(f"has {count} triangles, of which Mitsuba reads {faces}")
        return
    wrong = _negative_index(content, properties, faces)
    if wrong is not None:
        raise ValueError(f"has a face of vertex {wrong:.0f}, of {vertices} from 0 on")
    if not np.isfinite(others).all():
        raise ValueError("has normals or texture coordinates that are no finite numbers")


def _read(path: Path, plugin: str, flat: bool) -> tuple[NDArray[Any], int, NDArray[Any]]:
    """Return a mesh's indices, how many vertices it has, and their normals and coordinates.

    The mesh itself must not outlive this: Dr.Jit traces every one at the next virtual call.
    """
    import mitsuba as mi

    mesh = mi.load_dict({"type": plugin, "filename": str(path), "face_normals": flat})
    others = [np.array(mesh.vertex_normals_buffer()), np.array(mesh.vertex_texcoords_buffer())]
    return np.array(mesh.faces_buffer()), mesh.vertex_count(), np.concatenate(others)


def _announced(content: bytes) -> list[list[str]]:
    """Return the words of a PLY face's properties; refuse a file too short for what it announces.

    Each property of each row takes a byte at least.
    """
    elements: list[tuple[str, int, list[list[str]]]] = []
    for line in io.BytesIO(content[:_LONGEST_HEADER]):
        match line.decode("latin-1").split():
            case ["end_header", *_]:
                break
            case ["element", name, count] if re.fullmatch("[0-9]{1,10}", count):
                elements.append((name, int(count), []))
            case ["element", *words]:
                raise ValueError(f"has the line 'element {' '.join(words)[:80]}' in its header")
            case ["property", *words] if elements:
                elements[-1][2].append(words)
    else:
        raise ValueError("has no PLY header")
    for name, rows, properties in elements:
        if rows * max(len(properties), 1) > len(content):
            raise ValueError(f"is cut short: it should hold {rows} x {name}")
    names = [name for name, _, _ in elements]
    if names[:2] != ["vertex", "face"] or {"vertex", "face"} & set(names[2:]):
        raise ValueError(f"has the elements {', '.join(names)}; it needs vertex, then face")
    return elements[1][2]


def _negative_index(content: bytes, properties: list[list[str]], faces: int) -> float | None:
    """Return a negative index among the faces, which end a PLY file that Mitsuba has read.

    In a text all numbers are read anew: Mitsuba takes ``0.01.0`` for two.
    """
    order = ">" if b"\nformat binary_big_endian" in content else "<"
    fields: list[tuple[str, str] | tuple[str, str, int]] = []
    for *kinds, name in properties:
        kind = order + _NUMBERS[kinds[-1]]
        if kinds[0] == "list":
            fields += [(f"length of {name}", order + _NUMBERS[kinds[1]]), (name, kind, 3)]
        else:
            fields.append((name, kind))
    row = np.dtype(fields)
    if b"\nformat ascii" in content:
        row = np.dtype([(name, np.float64, row[name].shape) for name in row.names or ()])
        numbers = np.array(content.rpartition(b"end_header")[2].split(), np.float64)
        rows = numbers[-faces * (row.itemsize // 8) :].view(row)
    else:
        rows = np.frombuffer(content[-faces * row.itemsize :], row)
    name = next(name for *_, name in properties if name in ("vertex_index", "vertex_indices"))
    wrong = ~(rows[name] >= 0)
    return float(rows[name][wrong][0]) if wrong.any() else None


def _triangles(content: bytes) -> int:
    """Return how many triangles the faces of an OBJ file have, a polygon as a fan."""
    triangles = 0
    for line in content.splitlines():
        kind, *words = line.partition(b"#")[0].split() or [b""]
        if kind == b"f":
            if len(words) < 3:
                raise ValueError(f"has a face of {len(words)} corners")
            triangles += len(words) - 2
        elif kind == b"vt" and not all(math.isfinite(float(word)) for word in words):
            raise ValueError("has texture coordinates that are no finite numbers")
    return triangles
