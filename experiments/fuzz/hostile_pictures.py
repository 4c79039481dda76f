"""Hostile pictures and sequences: small files that claim much, unpack to much, or never end."""

from __future__ import annotations

import bz2
import gzip
import io
import json
import pickle
import struct
import zipfile
import zlib
from collections.abc import Iterator
from functools import cache

import numpy as np

from experiments.fuzz.damage import png_chunk
from experiments.fuzz.sound import COUNTS, SHAPE, Case

_MANY = 3 << 28
"""Bytes that a bomb unpacks to."""


class _Trap:
    """Ends the process that unpickles it."""

    def __reduce__(self) -> tuple[object, tuple[int]]:
        import os

        return os._exit, (66,)


def hostile_pictures() -> Iterator[Case]:
    """Make each hostile picture once, for photographs and for hidden images."""
    for kind, content in (*_npy(), *_npz(), *_png(), *_tiff(), *_jpeg(), *_exr()):
        for reader in ("photograph", "hidden image"):
            yield Case(reader, f"hostile {kind}", {"y": content})
    for kind, content in _matlab():
        yield Case("photograph", f"hostile {kind}", {"y": content})
    yield from _sequences()


@cache
def zeros(count: int, packer: str = "zlib") -> bytes:
    """Compress many zeros without holding them."""
    window = {"zlib": 15, "raw": -15, "gzip": 31, "bz2": 0}[packer]
    compressor = zlib.compressobj(6, zlib.DEFLATED, window) if window else bz2.BZ2Compressor(1)
    chunks = [compressor.compress(bytes(1 << 24)) for _ in range(count >> 24)]
    return b"".join(chunks) + compressor.flush()


def npy_header(shape: object, descr: object = "<f8", order: bool = False) -> bytes:
    """Header of an NPY file of version 2 that announces anything."""
    text = repr({"descr": descr, "fortran_order": order, "shape": shape}).encode() + b"\n"
    return b"\x93NUMPY\x02\x00" + struct.pack("<I", len(text)) + text


def _npy() -> Iterator[tuple[str, bytes]]:
    shapes: list[object] = [(1 << 20, 1 << 20, 3), (1 << 62, 1 << 62), (-6, -5), (-6, 5, 3)]
    shapes += [(0, 5, 3), (1,) * 64, (1 << 26,), (9000, 9000, 3), (True, 5), "x", (6.0, 5), ()]
    shapes += [(1 << 70,), (6, 5, 3)]
    for shape in shapes:
        yield "npy size", npy_header(shape) + bytes(64)
    kinds: list[object] = ["<U1000000000", "|V4294967295", "<M8[s]", "|O", "<c16", "<f16", "|b1"]
    kinds += [("<f4", (1 << 30,)), [("a", "<f8")] * 2, "<f2", [("x", [("y", "<f4")])], "<i8,<i8"]
    for descr in kinds:
        yield "npy type", npy_header(SHAPE, descr) + bytes(720)
    yield "npy header", b"\x93NUMPY\x02\x00" + struct.pack("<I", 0xFFFFFFFF) + b"{" * 99
    for depth in (90, 5000, 200_000):
        text = b"(" * depth + b")" * depth + b"\n"
        yield "npy nesting", b"\x93NUMPY\x02\x00" + struct.pack("<I", len(text)) + text
    for version in (0, 3, 9, 255):
        yield "npy version", b"\x93NUMPY" + bytes([version, 0]) + npy_header(SHAPE)[8:] + bytes(720)
    trap = npy_header((1,), "|O") + pickle.dumps(np.array([_Trap()], dtype=object))
    yield "npy pickle", trap
    yield "npz pickle", _zipped({"photograph.npy": trap, "hidden.npy": trap})


def _zipped(members: dict[str, bytes], method: int = zipfile.ZIP_DEFLATED) -> bytes:
    stream = io.BytesIO()
    with zipfile.ZipFile(stream, "w", method) as archive:
        for name, content in members.items():
            archive.writestr(name, content)
    return stream.getvalue()


def _zip_of(prefix: bytes, tail: int, method: int) -> bytes:
    """Zip archive of `photograph` and `hidden`: a prefix, then zeros, compressed unheld."""
    if method == zipfile.ZIP_BZIP2:
        packed = bz2.compress(prefix) + zeros(tail, "bz2")
    else:
        deflate = zlib.compressobj(9, zlib.DEFLATED, -15)
        packed = deflate.compress(prefix) + deflate.flush(zlib.Z_FULL_FLUSH) + zeros(tail, "raw")
    crc = zlib.crc32(prefix)
    for _ in range(tail >> 24):
        crc = zlib.crc32(bytes(1 << 24), crc)
    body, directory = b"", b""
    size = len(prefix) + tail
    for name in (b"photograph.npy", b"hidden.npy"):
        common = struct.pack(
            "<HHHHHIIIHH", 20, 0, method, 0, 33, crc, len(packed), size, len(name), 0
        )
        directory += b"PK\x01\x02\x14\x00" + common + struct.pack("<HHHI", 0, 0, 0, 0)
        directory += struct.pack("<I", len(body)) + name
        body += b"PK\x03\x04" + common + name + packed
    end = struct.pack("<HHHHIIH", 0, 0, 2, 2, len(directory), len(body), 0)
    return body + directory + b"PK\x05\x06" + end


def _npz() -> Iterator[tuple[str, bytes]]:
    for method in (zipfile.ZIP_DEFLATED, zipfile.ZIP_BZIP2):
        yield "npz bomb", _zip_of(npy_header((_MANY >> 3,)), _MANY, method)
        yield "npz bomb", _zip_of(npy_header((_MANY >> 6, 1, 3)), _MANY, method)
        header = b"\x93NUMPY\x02\x00" + struct.pack("<I", _MANY - 99)
        yield "npz header bomb", _zip_of(header, _MANY, method)
    member = npy_header(SHAPE) + bytes(240)
    yield "npz of many", _zipped({f"{k}.npy": b"" for k in range(20_000)})
    yield "npz of odd names", _zipped({"\x1b[2J\n\r.npy": member, "../photograph.npy": member})
    yield "npz of long names", _zipped({f"{'a' * 60_000}{k}.npy": b"" for k in range(9)})
    content = bytearray(_zipped({"photograph.npy": member, "hidden.npy": member}))
    for offset in (16, 20, 24, 42):  # checksum, sizes and place in the directory
        edited = bytearray(content)
        at = edited.index(b"PK\x01\x02") + offset
        edited[at : at + 4] = b"\xff\xff\xff\xff"
        yield "npz directory", bytes(edited)


def _png_of(
    columns: int, rows: int, depth: int, colour: int, *chunks: tuple[bytes, bytes]
) -> bytes:
    header = struct.pack(">IIBBBBB", columns, rows, depth, colour, 0, 0, 0)
    parts = [png_chunk(kind, body) for kind, body in ((b"IHDR", header), *chunks, (b"IEND", b""))]
    return b"\x89PNG\r\n\x1a\n" + b"".join(parts)


def _png() -> Iterator[tuple[str, bytes]]:
    rows, columns = SHAPE
    for depth in (8, 16):
        for size in ((0, 0), (1 << 31, 5), ((1 << 31) - 1,) * 2, (1, (1 << 31) - 1), (16_000,) * 2):
            yield "png size", _png_of(*size, depth, 2, (b"IDAT", b""))
        bomb = (b"IDAT", zeros(_MANY))
        yield "png bomb", _png_of(columns, rows, depth, 2, bomb)
        yield "png bomb", _png_of(9000, 9000, depth, 2, bomb)
        plain = (b"IDAT", zlib.compress(bytes(rows * (1 + columns * depth * 3 // 8))))
        for kind in (b"zTXt", b"iCCP"):
            yield (
                f"png {kind.decode()} bomb",
                _png_of(columns, rows, depth, 2, (kind, b"key\x00\x00" + zeros(_MANY >> 2)), plain),
            )
        text = (b"iTXt", b"key\x00\x01\x00\x00\x00" + zeros(_MANY >> 2))
        yield "png iTXt bomb", _png_of(columns, rows, depth, 2, text, plain)
        empty = [(b"IDAT", b"")] * 50_000
        yield "png of many chunks", _png_of(columns, rows, depth, 2, *empty, plain)
        frames = (b"acTL", struct.pack(">II", 0xFFFFFFFF, 0))
        yield "png animation", _png_of(columns, rows, depth, 2, frames, plain)
        for colour in (1, 3, 5, 7, 255):
            yield "png colour", _png_of(columns, rows, depth, colour, plain)
    yield "png bits", _png_of(16_000, 16_000, 1, 0, (b"IDAT", zeros(1 << 25)))


def _tag(code: int, kind: int, count: int, value: int) -> bytes:
    return struct.pack("<HHII", code, kind, count, value)


def _tiff_of(tags: dict[int, tuple[int, int, int]], data: bytes = b"", following: int = 0) -> bytes:
    """Little-endian TIFF: data at byte 8, then one directory."""
    entries = b"".join(_tag(code, *entry) for code, entry in sorted(tags.items()))
    directory = struct.pack("<H", len(tags)) + entries + struct.pack("<I", following)
    return b"II*\x00" + struct.pack("<I", 8 + len(data)) + data + directory


def _tiff() -> Iterator[tuple[str, bytes]]:
    rows, columns = SHAPE
    data = COUNTS[..., 0].tobytes()
    tags = {256: (4, 1, columns), 257: (4, 1, rows), 258: (3, 1, 16), 259: (3, 1, 1),
            262: (3, 1, 1), 273: (4, 1, 8), 277: (3, 1, 1), 278: (4, 1, rows),
            279: (4, 1, len(data))}  # fmt: skip
    yield "tiff", _tiff_of(tags, data)
    yield "tiff loop", _tiff_of(tags, data, 8 + len(data))
    for code in tags:
        for value in (0, 1, 0xFFFF, 0x7FFFFFFF, 0xFFFFFFFF):
            yield f"tiff tag {code}", _tiff_of({**tags, code: (4, 1, value)}, data)
        yield f"tiff tag {code} of many", _tiff_of({**tags, code: (4, 0xFFFFFFFF, 8)}, data)
    for predictor, code in ((1, 8), (2, 8), (3, 8), (1, 32946), (1, 5), (1, 32773), (1, 34925)):
        for bits in (8, 16):
            bomb = zeros(_MANY)
            packed = {**tags, 258: (3, 1, bits), 259: (3, 1, code), 279: (4, 1, len(bomb)),
                      317: (3, 1, predictor)}  # fmt: skip
            yield "tiff bomb", _tiff_of(packed, bomb)
    shaped = b'{"shape": [1000000, 1000000, 3]}\x00'
    described = {**tags, 270: (2, len(shaped), 8 + len(data))}
    yield "tiff shape", _tiff_of(described, data + shaped)
    laughs = _laughs().encode() + b"\x00"
    yield "tiff OME", _tiff_of({**tags, 270: (2, len(laughs), 8 + len(data))}, data + laughs)
    inner = {**tags, 330: (4, 1, 8 + len(data))}
    yield "tiff within itself", _tiff_of(inner, data)
    chain = bytearray(b"II*\x00\x08\x00\x00\x00")
    for _ in range(20_000):
        following = len(chain) + 2 + 12 + 4
        chain += struct.pack("<H", 1) + _tag(256, 4, 1, 5) + struct.pack("<I", following)
    yield "tiff of many", bytes(chain)


def _laughs() -> str:
    entities = "".join(f'<!ENTITY l{k} "{f"&l{k - 1};" * 10}">' for k in range(1, 12))
    head = '<?xml version="1.0" encoding="UTF-8"?><!DOCTYPE OME [<!ENTITY l0 "ha">'
    return f"{head}{entities}]><OME>&l11;</OME>"


def _jpeg() -> Iterator[tuple[str, bytes]]:
    from PIL import Image

    stream = io.BytesIO()
    Image.fromarray(np.zeros((*SHAPE, 3), np.uint8)).save(stream, "JPEG", progressive=True)
    content = stream.getvalue()
    start = content.index(b"\xff\xc2") + 5
    for size in ((0, 0), (65535, 65535), (65535, 1), (8000, 8000)):
        yield "jpeg size", content[:start] + struct.pack(">HH", *size) + content[start + 4 :]
    scan = content.index(b"\xff\xda")
    end = content.index(b"\xff\xda", scan + 2)
    large = content[:start] + struct.pack(">HH", 4000, 4000) + content[start + 4 : scan]
    yield "jpeg of many scans", large + content[scan:end] * 2000 + content[end:]
    for offset in (0, 8, 0xFFFFFFFF):
        exif = b"Exif\x00\x00II*\x00" + struct.pack("<I", offset)
        exif += struct.pack("<H", 2) + _tag(0x0112, 3, 1, 6) + _tag(0x8769, 4, 1, 8) + bytes(4)
        segment = b"\xff\xe1" + struct.pack(">H", len(exif) + 2) + exif
        yield "jpeg exif", content[:2] + segment + content[2:]


def _exr_of(attributes: list[tuple[bytes, bytes, bytes]], tail: bytes, version: int = 2) -> bytes:
    entries = [n + b"\0" + t + b"\0" + struct.pack("<i", len(v)) + v for n, t, v in attributes]
    return b"\x76\x2f\x31\x01" + struct.pack("<I", version) + b"".join(entries) + b"\0" + tail


def _exr() -> Iterator[tuple[str, bytes]]:
    def attributes(
        window: tuple[int, int, int, int], channels: tuple[bytes, ...] = (b"B", b"G", b"R")
    ) -> list[tuple[bytes, bytes, bytes]]:
        chlist = b"".join(c + b"\0" + struct.pack("<iIii", 2, 0, 1, 1) for c in channels) + b"\0"
        box = struct.pack("<4i", *window)
        return [
            (b"channels", b"chlist", chlist), (b"compression", b"compression", b"\x03"),
            (b"dataWindow", b"box2i", box), (b"displayWindow", b"box2i", box),
            (b"lineOrder", b"lineOrder", b"\0"), (b"pixelAspectRatio", b"float", bytes(4)),
            (b"screenWindowCenter", b"v2f", bytes(8)), (b"screenWindowWidth", b"float", bytes(4)),
        ]  # fmt: skip

    least, most = -(1 << 31), (1 << 31) - 1
    windows = [(0, 0, 4, 5), (0, 0, 9000, 9000), (0, 0, most, most), (least, least, most, most),
               (0, 0, 5, most), (4, 5, 0, 0), (0, 0, -1, -1), (most - 4, most - 5, most, most),
               (0, 0, 16_000, 5), (0, 0, 5, 80_000_000)]  # fmt: skip
    for window in windows:
        yield "exr size", _exr_of(attributes(window), bytes(600))
        tiles = (b"tiles", b"tiledesc", struct.pack("<IIB", 0x7FFFFFFF, 0x7FFFFFFF, 2))
        yield "exr tiles", _exr_of([*attributes(window), tiles], bytes(600), 0x202)
        one = (b"tiles", b"tiledesc", struct.pack("<IIB", 1, 1, 0))
        yield "exr tiles", _exr_of([*attributes(window), one], bytes(600), 0x202)
    small = (0, 0, SHAPE[1] - 1, SHAPE[0] - 1)
    many = tuple(b"c%d" % k for k in range(20_000))
    yield "exr channels", _exr_of(attributes(small, many), bytes(600))
    for name in (b"\x1b[2J", b"a\nb", b"\xff\xfe", b"R" * 300, b""):
        yield "exr names", _exr_of(attributes(small, (name, b"B", b"G")), bytes(600))
    for kind in (b"string", b"preview", b"stringvector", b"bytes", b"opaque"):
        for value in (b"\xff\xff\xff\x7f" * 2, b"", b"\xff" * 40):
            yield "exr attributes", _exr_of([*attributes(small), (b"x", kind, value)], bytes(600))
    huge = _exr_of([], b"")[:-1] + b"channels\0chlist\0" + struct.pack("<i", most) + bytes(99)
    yield "exr attributes", huge


def _matlab() -> Iterator[tuple[str, bytes]]:
    head = b"MATLAB 5.0 MAT-file".ljust(124) + b"\x00\x01IM"

    def element(kind: int, body: bytes, size: int | None = None) -> bytes:
        size = len(body) if size is None else size
        return struct.pack("<II", kind, size & 0xFFFFFFFF) + body + bytes(-len(body) % 8)

    def matrix(name: bytes, shape: tuple[int, ...], numbers: bytes, code: int = 9) -> bytes:
        extents = b"".join(struct.pack("<i", n) for n in shape)
        flags = element(6, struct.pack("<II", 6, 0))
        return element(14, flags + element(5, extents) + element(1, name) + element(code, numbers))

    fields = matrix(b"shutter_speed", (1, 1), bytes(6) + b"\xf0\x3f")
    fields += matrix(b"iterations", (1, 1), bytes(6) + b"\xf0\x3f")
    for shape in ((12, 10), (-12, -10), (1 << 30, 1 << 30), (0, 0), (2, 0), (), (12,), (1,) * 99):
        yield "mat size", head + matrix(b"image", shape, bytes(960)) + fields
    for code in (0, 8, 10, 14, 15, 16, 255, 65535):
        yield "mat type", head + matrix(b"image", (12, 10), bytes(960), code) + fields
    for size in (0, 1, 1 << 31, (1 << 32) - 1):
        yield "mat element", head + element(14, bytes(40), size) + fields
        yield "mat element", head + element(15, zlib.compress(bytes(40)), size) + fields
    for name in (b"\x1b[2J", b"a\nb", b"\xff" * 9, b"x" * 100_000, b""):
        yield "mat names", head + matrix(name, (1, 1), bytes(8)) + fields
    bomb = zeros(_MANY)
    yield "mat bomb", head + element(15, bomb)
    yield "mat bomb", head + element(15, bomb) * 8
    nested = matrix(b"image", (12, 10), bytes(960))
    for _ in range(500):
        nested = element(15, zlib.compress(nested))
    yield "mat nesting", head + nested + fields
    cell = b""
    for _ in range(5000):
        cell = element(14, element(6, struct.pack("<II", 1, 0)) + element(5, bytes(8)) + cell)
    yield "mat nesting", head + cell + fields
    yield "mat of many", head + matrix(b"a", (1, 1), bytes(8)) * 20_000 + fields


def _sequences() -> Iterator[Case]:
    for count in (0, -1, 10**6, 10**9, 10**12, 1 << 62):
        stack = npy_header((count, *SHAPE, 3), "<f4") + bytes(3600)
        for reader in ("frames", "hidden frames"):
            yield Case(reader, "hostile npy stack", {"y": stack})
        yield Case("frames", "hostile npz stack", {"y": _zipped({"photograph.npy": stack})})
    for shape in ((3, 1 << 40, 5, 3), (3, 6, 5, 1 << 40), (3, 0, 0, 3), (3, 9000, 9000, 3)):
        stack = npy_header(shape, "<f4") + bytes(3600)
        yield Case("hidden frames", "hostile npy stack", {"y": stack})
    bomb = _zip_of(npy_header((_MANY // 720, *SHAPE, 3)), _MANY, zipfile.ZIP_DEFLATED)
    yield Case("frames", "hostile npz stack", {"y": bomb})
    yield Case("frames", "hostile folder", {"clip/x.txt": b""}, "clip")
    yield Case("frames", "hostile folder", {f"clip/{'1' * 200}{k}.npy": b"" for k in "12"}, "clip")
    yield Case("frames", "hostile folder", {f"clip/{'9' * 240}²x.npy": b""}, "clip")
    yield from _zarr()


def _zarr() -> Iterator[Case]:
    def array(**changes: object) -> bytes:
        entry: dict[str, object] = {
            "zarr_format": 3, "node_type": "array", "shape": [3, *SHAPE, 3], "data_type": "float32",
            "chunk_grid": {"name": "regular", "configuration": {"chunk_shape": [2, *SHAPE, 3]}},
            "chunk_key_encoding": {"name": "default", "configuration": {"separator": "/"}},
            "fill_value": 1.0, "codecs": [{"name": "bytes", "configuration": {"endian": "little"}},
            {"name": "gzip", "configuration": {"level": 5}}], "attributes": {},
        }  # fmt: skip
        return json.dumps({**entry, **changes}).encode()

    def grid(*chunks: object) -> dict[str, object]:
        return {"name": "regular", "configuration": {"chunk_shape": list(chunks)}}

    chunk = "y.zarr/c/0/0/0/0"
    good = gzip.compress(np.ones((2, *SHAPE, 3), "<f4").tobytes())
    changes: list[dict[str, object]] = [{}]
    changes += [{"shape": [n, *SHAPE, 3]} for n in (0, -1, 10**6, 10**9, 10**15, 2**63, 2**70, 1.5)]
    changes += [{"chunk_grid": grid(n, *SHAPE, 3)} for n in (0, -1, 10**9, 2**40, 2**64, "1")]
    changes += [{"chunk_grid": {"name": "x" * 5000}}, {"codecs": []}, {"codecs": [{"name": "?"}]}]
    changes += [{"fill_value": value} for value in ("NaN", None, "x" * 99, {}, 1e400, [1])]
    changes += [
        {"data_type": t} for t in ("object", "r4294967288", "complex128", {}, "float64", "")
    ]
    changes += [{"attributes": {"scale_factor": 2}}, {"node_type": "group"}, {"zarr_format": 9}]
    changes += [{"dimension_names": ["x"] * 9}, {"storage_transformers": [{"name": "x"}]}]
    inner = {"chunk_shape": [1, *SHAPE, 3], "codecs": [{"name": "bytes"}], "index_codecs": []}
    changes += [{"codecs": [{"name": "sharding_indexed", "configuration": inner}]}]
    for change in changes:
        yield Case(
            "frames", "hostile zarr", {"y.zarr/zarr.json": array(**change), chunk: good}, "y.zarr"
        )
    for packed in (zeros(_MANY, "gzip"), gzip.compress(b""), b"", zeros(_MANY, "gzip") * 2):
        yield Case("frames", "zarr bomb", {"y.zarr/zarr.json": array(), chunk: packed}, "y.zarr")
    for name in ("zstd", "blosc"):
        codecs = [{"name": "bytes"}, {"name": name, "configuration": {}}]
        frame = b"\x28\xb5\x2f\xfd\xe0" + struct.pack("<Q", 1 << 40) + bytes(30)
        head = b"\x02\x01\x01\x04" + struct.pack("<III", 0x7FFFFFFF, 0x7FFFFFFF, 64) + bytes(48)
        for packed in (frame, head):
            files = {"y.zarr/zarr.json": array(codecs=codecs), chunk: packed}
            yield Case("frames", "zarr bomb", files, "y.zarr")
    for text in (b"[" * 200_000, b"", b"null", b"{}", b'{"zarr_format":' + b"9" * 9000 + b"}"):
        yield Case("frames", "hostile zarr", {"y.zarr/zarr.json": text}, "y.zarr")
    for codec in ({"id": "pickle"}, {"id": "json2"}, {"id": "zlib", "level": 1}, {"id": "?"}, 5):
        entry = {"zarr_format": 2, "shape": [3, *SHAPE, 3], "chunks": [2, *SHAPE, 3], "order": "C",
                 "dtype": "<f4", "compressor": codec, "fill_value": 0, "filters": None}  # fmt: skip
        for packed in (pickle.dumps(_Trap()), zeros(_MANY)):
            files = {"y.zarr/.zarray": json.dumps(entry).encode(), "y.zarr/0.0.0.0": packed}
            yield Case("frames", "zarr bomb", files, "y.zarr")
            files = {**files, "y.zarr/.zarray": json.dumps({**entry, "dtype": "|O"}).encode()}
            yield Case("frames", "zarr bomb", files, "y.zarr")
