"""Numeric matrices of MATLAB files of version 5 to 7.

Read here rather than by `scipy.io.loadmat`, which ends the whole process with a segmentation
fault where a damaged file names a data type that does not exist: it did so for 7 of 60 files in
which one byte was changed.

References
----------
The MathWorks, *MAT-File Format*, "Level 5 MAT-File Format".
"""

from __future__ import annotations

import struct
import zlib
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from periscopy_sim.storage.formats.decoding import UNPACKED_COUNT, check_count, decoding

_HEADER = 128  # bytes
_MATRIX, _COMPRESSED = 14, 15  # types of data elements; those of numbers:
_DTYPES = {
    1: "i1", 2: "u1", 3: "i2", 4: "u2", 5: "i4", 6: "u4", 7: "f4", 9: "f8", 12: "i8", 13: "u8",
}  # fmt: skip
_OPAQUE = 17  # classes of matrices; from double to uint64 they hold numbers:
_NUMBER_CLASSES = range(6, 16)
_OTHER_CLASSES = {
    1: "cell", 2: "struct", 3: "object", 4: "char", 5: "sparse", 16: "function handle",
    _OPAQUE: "opaque object",
}  # fmt: skip
_LOGICAL_FLAG, _COMPLEX_FLAG = 0x200, 0x800
_UNPACKED = 4 * UNPACKED_COUNT  # bytes that compressed variables may hold in a file of any size,
_LARGEST_RATIO = 16  # and for each byte of a larger one


@dataclass(frozen=True, eq=False)
class Matrix:
    """A variable of a MATLAB file."""

    kind: str  # `real` for real numbers, else the class of what it holds
    values: NDArray[Any] | None  # real numbers as they are stored, None for all other kinds


def read_matrices(path: Path) -> dict[str, Matrix]:
    """Read the variables of a MATLAB file; only real numbers are decoded."""
    with decoding(path, "MATLAB", "save it again in MATLAB with -v7"):
        content = path.read_bytes()
        order = "<" if content[_HEADER - 2 : _HEADER] == b"IM" else ">"
        return dict(
            _matrix(body, order, path)
            for kind, body in _unpacked(content[_HEADER:], order)
            if kind == _MATRIX
        )


def _unpacked(content: bytes, order: str) -> Iterator[tuple[int, bytes]]:
    """Yield data elements, those within compressed ones in place of these."""
    left = max(_UNPACKED, _LARGEST_RATIO * len(content))
    for kind, body in _elements(content, order):
        if kind == _COMPRESSED:
            unpacker = zlib.decompressobj()
            unpacked = unpacker.decompress(body, left) if left else b""
            left -= len(unpacked)
            if not unpacker.eof:
                raise ValueError("a compressed variable is cut short or too large")
            yield from _elements(unpacked, order)
        else:
            yield kind, body


def _elements(content: bytes, order: str) -> Iterator[tuple[int, bytes]]:
    """Yield type and bytes of the data elements that lie one behind the other."""
    position = 0
    while position < len(content):
        (word,) = struct.unpack_from(f"{order}I", content, position)
        if word >> 16:  # a small element: its size above its type, its bytes within the tag
            kind, size, start = word & 0xFFFF, word >> 16, position + 4
            following = position + 8
        else:
            kind, start = word, position + 8
            (size,) = struct.unpack_from(f"{order}I", content, position + 4)
            following = start + size + (0 if kind == _COMPRESSED else -size % 8)
        if start + size > min(following, len(content)):
            raise ValueError(f"a variable is cut short {position} bytes in")
        yield kind, content[start : start + size]
        position = following


def _matrix(body: bytes, order: str, path: Path) -> tuple[str, Matrix]:
    """Return name and matrix of an element: its flags, dimensions, name and numbers in turn."""
    (_, head), (_, second), *rest = _elements(body, order)
    (flags,) = struct.unpack_from(f"{order}I", head)
    if flags & 0xFF == _OPAQUE:  # has no dimensions
        return second.decode("latin-1"), Matrix(_OTHER_CLASSES[_OPAQUE], None)
    name = rest[0][1].decode("latin-1")
    kind = _kind(flags)
    if kind != "real":
        return name, Matrix(kind, None)
    shape = struct.unpack(f"{order}{len(second) // 4}i", second)
    check_count(shape, path)
    code, numbers = rest[1]
    values = np.frombuffer(numbers, f"{order}{_DTYPES[code]}").reshape(shape, order="F")
    return name, Matrix(kind, values)


def _kind(flags: int) -> str:
    """Return the class of a matrix from its flags."""
    if flags & 0xFF not in _NUMBER_CLASSES:
        return _OTHER_CLASSES.get(flags & 0xFF, "unknown")
    if flags & _LOGICAL_FLAG:
        return "logical"
    return "complex" if flags & _COMPLEX_FLAG else "real"
