"""Damage to sound files: cut, flipped, spliced, and edited where sizes and numbers stand."""

from __future__ import annotations

import io
import re
import struct
import zipfile
import zlib
from collections.abc import Callable

import numpy as np

from experiments.fuzz.sound import Case

Random = np.random.Generator

_EXTREMES = (0, 1, 2, 0x7F, 0x80, 0xFF, 0x7FFF, 0x8000, 0xFFFF, 0x7FFFFFFF, 0x80000000, 0xFFFFFFFF,
             0x10000, 0x1000000, 1 << 32, (1 << 62) + 1, (1 << 63) - 1, 1 << 63,
             (1 << 64) - 1)  # fmt: skip
_NUMBERS = (b"0", b"-1", b"1", b"2", b"4294967295", b"4294967296", b"2147483648", b"1e400", b"nan",
            b"inf", b"-inf", b"1e-320", b"99999999999999999999999", b"", b"0.5", b"1_0", b"0x10",
            b"65536", b"100000000", b"1e30", b"null", b"x")  # fmt: skip
_TEXT = (".xml", ".yaml", ".obj", ".json", ".zarray", ".zattrs", ".zgroup")
_PNG = b"\x89PNG\r\n\x1a\n"


def damaged(case: Case, others: list[Case], rng: Random) -> Case:
    """Damage one of a case's files, once or a few times.

    Parameters
    ----------
    case
        Sound.
    others
        Sound cases to splice pieces of in.
    rng
        Draws the damage.
    """
    names = sorted(case.files)
    name = names[int(rng.integers(len(names)))]
    content = case.files[name]
    donor = others[int(rng.integers(len(others)))]
    other = next(iter(donor.files.values()))
    operations: list[Callable[[bytes], bytes]] = [
        lambda data: _cut(data, rng),
        lambda data: _flip(data, rng),
        lambda data: _splice(data, other, rng),
        lambda data: _edit_field(data, rng),
        lambda data: _edit_field(data, rng),
    ]
    if name.endswith(_TEXT) or b"ascii" in content[:20]:
        operations += [lambda data: _edit_number(data, rng)] * 4
        operations += [lambda data: _move_line(data, rng)] * 2

    def damage(data: bytes) -> bytes:
        for _ in range(int(rng.choice([1, 1, 1, 2, 4]))):
            data = operations[int(rng.integers(len(operations)))](data)
        return data

    content = _resealed(content, damage, rng) if rng.random() < 0.5 else damage(content)
    return Case(case.reader, case.kind, {**case.files, name: content}, case.target)


def _place(data: bytes, rng: Random, width: int = 1) -> int:
    """Position in the data, more often near its start, where the headers are."""
    reach = max(1, len(data) - width + 1)
    return int(rng.integers(min(reach, 512) if rng.random() < 0.5 else reach))


def _cut(data: bytes, rng: Random) -> bytes:
    return data[: int(rng.integers(len(data) + 1))]


def _flip(data: bytes, rng: Random) -> bytes:
    flipped = bytearray(data)
    for _ in range(int(rng.integers(1, 9))):
        if flipped:
            flipped[_place(data, rng)] ^= 1 << int(rng.integers(8))
    return bytes(flipped)


def _splice(data: bytes, other: bytes, rng: Random) -> bytes:
    """Copy a piece of the data, of another file or of noise over, into, or out of the data."""
    source = (data, other, rng.bytes(64))[int(rng.integers(3))]
    start, length = _place(source, rng), int(rng.integers(1, 200))
    piece = source[start : start + length]
    place = _place(data, rng)
    removed = (0, length, length)[int(rng.integers(3))]
    if rng.random() < 0.2:
        piece = b""
    return data[:place] + piece + data[place + removed :]


def _edit_field(data: bytes, rng: Random) -> bytes:
    """Set an integer of 1, 2, 4 or 8 bytes to a value at which programs break."""
    width = int(rng.choice([1, 2, 4, 4, 8]))
    value = _EXTREMES[int(rng.integers(len(_EXTREMES)))] % (1 << 8 * width)
    place = _place(data, rng, width)
    place -= place % width if rng.random() < 0.5 else 0
    number = value.to_bytes(width, "little" if rng.random() < 0.5 else "big")
    return data[:place] + number + data[place + width :]


def _edit_number(data: bytes, rng: Random) -> bytes:
    """Replace a number in a text."""
    found = list(re.finditer(rb"-?\d+(\.\d+)?", data))
    if not found:
        return data
    start, end = found[int(rng.integers(len(found)))].span()
    return data[:start] + _NUMBERS[int(rng.integers(len(_NUMBERS)))] + data[end:]


def _move_line(data: bytes, rng: Random) -> bytes:
    """Remove, double or move a line of a text."""
    lines = data.split(b"\n")
    line = lines.pop(int(rng.integers(len(lines))))
    for _ in range(int(rng.integers(3))):
        lines.insert(int(rng.integers(len(lines) + 1)), line)
    return b"\n".join(lines)


def _resealed(content: bytes, damage: Callable[[bytes], bytes], rng: Random) -> bytes:
    """Damage what checksums or compression protect, and set these right again."""
    if content.startswith(b"PK"):
        return _rezipped(content, damage)
    if content.startswith(_PNG):
        return _rechunked(content, damage, rng)
    return damage(content)


def _rezipped(content: bytes, damage: Callable[[bytes], bytes]) -> bytes:
    packed = io.BytesIO()
    with (
        zipfile.ZipFile(io.BytesIO(content)) as old,
        zipfile.ZipFile(packed, "w", zipfile.ZIP_DEFLATED) as new,
    ):
        for name in old.namelist():
            # An entry without a time: the same damage gives the same bytes.
            entry = zipfile.ZipInfo(name)
            new.writestr(entry, damage(old.read(name)), zipfile.ZIP_DEFLATED)
    return packed.getvalue()


def _rechunked(content: bytes, damage: Callable[[bytes], bytes], rng: Random) -> bytes:
    """Damage a chunk of a PNG file: its bytes, or what they compress."""
    chunks, position = [], len(_PNG)
    while position + 12 <= len(content):
        (size,) = struct.unpack_from(">I", content, position)
        kind = content[position + 4 : position + 8]
        chunks.append((kind, content[position + 8 : position + 8 + size]))
        position += 12 + size
    chosen = int(rng.integers(len(chunks)))
    kind, body = chunks[chosen]
    if kind == b"IDAT" and rng.random() < 0.7:
        body = zlib.compress(damage(zlib.decompress(body)))
    else:
        body = damage(body)
    chunks[chosen] = (kind, body)
    return _PNG + b"".join(_png_chunk(kind, body) for kind, body in chunks)


def _png_chunk(kind: bytes, body: bytes) -> bytes:
    """Put a PNG chunk together: its length, kind, body and checksum."""
    return struct.pack(">I", len(body)) + kind + body + struct.pack(">I", zlib.crc32(kind + body))
