"""Mesh files, checked before Mitsuba reads them: it takes sizes and indices at their word."""

from __future__ import annotations

import re
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

_LONGEST_HEADER = 1 << 16  # bytes
_LARGEST = float(np.finfo(np.float32).max)  # Mitsuba's numbers are of single precision
_NUMBERS = {
    "char": "i1", "int8": "i1", "uchar": "u1", "uint8": "u1", "short": "i2", "int16": "i2",
    "ushort": "u2", "uint16": "u2", "int": "i4", "int32": "i4", "uint": "u4", "uint32": "u4",
    "float": "f4", "float32": "f4", "double": "f8", "float64": "f8",
}  # fmt: skip
_ORDERS = {"binary_little_endian": "<", "binary_big_endian": ">", "ascii": "="}
_CORNER = re.compile(rb"([0-9]{1,10})(?:/([0-9]{0,10})(?:/([0-9]{1,10}))?)?")


def check_mesh(path: Path, plugin: str) -> None:
    """Check that a mesh file is whole, its numbers finite and its indices those of its vertices.

    Parameters
    ----------
    path
        The file.
    plugin
        Mitsuba's name of its format; others than ``ply`` and ``obj`` are not looked into.

    Raises
    ------
    ValueError
        Saying what is wrong.
    """
    if plugin == "ply":
        _check_ply(path.read_bytes())
    elif plugin == "obj":
        _check_obj(path.read_bytes())


@dataclass(frozen=True)
class _Element:
    """Rows of a PLY file.

    Attributes
    ----------
    name
        Such as ``vertex``.
    count
        How many rows the header announces.
    row
        One row; the list of a face as its length and three indices.
    """

    name: str
    count: int
    row: np.dtype[np.void]


def _check_ply(content: bytes) -> None:
    header = re.match(rb"ply\s.*?\nend_header[ \t]*\r?\n", content[:_LONGEST_HEADER], re.DOTALL)
    if header is None:
        raise ValueError("has no PLY header")
    order, elements = _ply_elements(header[0].decode("latin-1"))
    names = [element.name for element in elements]
    if names[:2] != ["vertex", "face"] or "face" in names[2:] or "vertex" in names[2:]:
        raise ValueError(f"has the elements {', '.join(names)}; it needs vertex, then face")
    read = _text_rows if order == "=" else _binary_rows
    vertices, faces = read(content[header.end() :], elements[:2])
    for name in vertices.dtype.names or ():
        if not (np.abs(vertices[name]) <= _LARGEST).all():
            raise ValueError(f"has a vertex whose {name} is no finite number")
    if (faces["corners"] != 3).any():
        raise ValueError("has faces of other than three corners; triangulate it")
    indices = faces["indices"]
    if not len(indices):
        raise ValueError("has no faces")
    wrong = indices[(indices < 0) | (indices >= len(vertices))]
    if len(wrong):
        raise ValueError(f"has a face of vertex {wrong[0]:.0f}, of {len(vertices)} from 0 on")


def _ply_elements(header: str) -> tuple[str, list[_Element]]:
    """Order of the bytes, and what the header announces."""
    order, found = "", []
    fields: list[tuple[str, str] | tuple[str, str, int]] = []
    for line in header.splitlines()[1:]:
        match line.split():
            case [] | ["comment" | "obj_info", *_] | ["end_header"]:
                pass
            case ["format", form, "1.0"] if form in _ORDERS:
                order = _ORDERS[form]
            case ["element", name, count] if order and count.isdecimal() and len(count) <= 10:
                fields = []
                found.append((name, int(count), fields))
            case ["property", "list", length, index, name] if found and found[-1][0] == "face":
                if "f" in _NUMBERS.get(length, "f") + _NUMBERS.get(index, "f"):
                    raise ValueError(f"has a list of {length} and {index}, which are no integers")
                fields += [("corners", order + _NUMBERS[length])]
                fields += [("indices", order + _NUMBERS[index], 3)]
            case ["property", kind, name] if found and kind in _NUMBERS:
                fields.append((name, order + _NUMBERS[kind]))
            case _:
                raise ValueError(f"has the line '{line[:80]}' in its header")
    elements = [_Element(name, count, np.dtype(fields)) for name, count, fields in found[:2]]
    elements += [_Element(name, count, np.dtype([])) for name, count, _ in found[2:]]
    if len(elements) > 1 and not {"corners", "indices"} <= set(elements[1].row.names or ()):
        raise ValueError("has faces without a list of vertices")
    return order, elements


def _binary_rows(body: bytes, elements: list[_Element]) -> list[NDArray[np.void]]:
    rows, start = [], 0
    for element in elements:
        if start + element.count * element.row.itemsize > len(body):
            raise ValueError(f"is cut short: it should hold {element.count} x {element.name}")
        rows.append(np.frombuffer(body, element.row, element.count, start))
        start += element.count * element.row.itemsize
    return rows


def _text_rows(body: bytes, elements: list[_Element]) -> list[NDArray[np.void]]:
    words, rows, start = body.split(), [], 0
    for element in elements:
        flat = [(name, *element.row[name].shape) for name in element.row.names or ()]
        width = sum(shape[0] if shape else 1 for _, *shape in flat)
        stop = start + element.count * width
        if stop > len(words):
            raise ValueError(f"is cut short: it should hold {element.count} x {element.name}")
        table = _numbers(words[start:stop]).reshape(element.count, width)
        if not (np.abs(table) <= _LARGEST).all():
            raise ValueError(f"has a {element.name} that is no row of finite numbers")
        values = np.zeros(element.count, [(name, np.float64, *shape) for name, *shape in flat])
        column = 0
        for name, *shape in flat:
            size = shape[0] if shape else 1
            values[name] = table[:, column : column + size] if shape else table[:, column]
            column += size
        rows.append(values)
        start = stop
    return rows


def _check_obj(content: bytes) -> None:
    known = {b"v": 0, b"vt": 0, b"vn": 0}
    largest, faces = [0, 0, 0], 0
    for number, line in enumerate(content.splitlines(), 1):
        kind, *words = line.split() or [b""]
        if kind in known:
            known[kind] += 1
            _check_numbers(words, 2 if kind == b"vt" else 3, number)
        elif kind == b"f":
            faces += 1
            _check_corners(words, largest, number)
    if not (known[b"v"] and faces):
        raise ValueError(f"has {known[b'v']} vertices and {faces} faces")
    for kind, most in zip(known, largest, strict=True):
        if most > known[kind]:
            raise ValueError(
                f"has a face that uses '{kind.decode()}' number {most}, of {known[kind]}"
            )


def _check_numbers(words: list[bytes], least: int, line: int) -> None:
    if len(words) < least or not (np.abs(_numbers(words)) <= _LARGEST).all():
        raise ValueError(f"has no {least} finite numbers in line {line}")


def _numbers(words: list[bytes]) -> NDArray[np.float64]:
    """Numbers of a text; what is no number is NaN."""
    try:
        return np.array(words, np.float64)
    except ValueError:
        return np.full(len(words), np.nan)


def _check_corners(words: list[bytes], largest: list[int], line: int) -> None:
    """Check a face, and keep the largest indices of vertices, texture coordinates and normals."""
    if len(words) < 3:
        raise ValueError(f"has a face of {len(words)} corners in line {line}")
    for word in words:
        corner = _CORNER.fullmatch(word)
        indices = [int(text) for text in corner.groups(b"") if text] if corner else [0]
        if min(indices) < 1:
            raise ValueError(
                f"has a face of '{word[:20].decode('latin-1')}' in line {line}; number vertices "
                "from 1 on"
            )
        assert corner is not None
        for k, text in enumerate(corner.groups()):
            largest[k] = max(largest[k], int(text or 0))
