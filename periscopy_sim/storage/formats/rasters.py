"""PNG, TIFF and JPEG files, read at the bit depth they were saved with."""

from __future__ import annotations

import math
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from periscopy_sim.errors import PhotographError
from periscopy_sim.photograph import check_size
from periscopy_sim.storage.formats.decoding import Picture, check_count, check_unpacked, decoding

_CHANGED_MODES = {"1": "L", "P": "RGB", "PA": "RGBA"}  # of Pillow's modes: what to convert each to
_DIRECT_MODES = ("L", "LA", "RGB", "RGBA")


def read_png(path: Path, _: str, size: tuple[int, int] | None) -> Picture:
    """Read a PNG file without changing its bit depth; one of 16 bits must have the size wanted."""
    rows, columns, depth = _png_header(path)
    if depth < 16:
        return _read_with_pillow(path, "PNG")
    if size is not None:  # decoding 16 bits is slow: not for a picture that cannot fit
        check_size((rows, columns), size, str(path))
    return _read_16_bit_png(path)


def read_jpeg(path: Path, *_: object) -> Picture:
    """Read a JPEG file, grey or RGB."""
    return _read_with_pillow(path, "JPEG")


def read_tiff(path: Path, *_: object) -> Picture:
    """Read by tifffile, which keeps 16-bit and floating-point values; the rest by Pillow."""
    import tifffile

    remedy = "save it again, uncompressed or with deflate compression"
    with decoding(path, "TIFF", remedy), tifffile.TiffFile(path) as file:
        places: set[int] = set()
        for each in file.pages:  # the next may be one before, and tifffile would never end
            if each.offset in places:
                raise PhotographError(f"{path}: its pages run in a circle; save or copy it again")
            places.add(each.offset)
        if len(file.series) != 1:
            raise PhotographError(f"{path}: holds {len(file.series)} pictures; save one alone")
        series, page = file.series[0], file.pages[0]
        check_count(series.shape, path)
        if series.dtype in (np.uint8, np.bool_):
            if len(file.pages) != 1:
                raise PhotographError(f"{path}: holds {len(file.pages)} pictures; save one alone")
            return _read_with_pillow(path, "TIFF")
        if page.photometric not in (tifffile.PHOTOMETRIC.MINISBLACK, tifffile.PHOTOMETRIC.RGB):
            raise PhotographError(f"{path}: is {page.photometric.name}; save it as grey or RGB")
        if page.tags.valueof("Orientation", 1) != 1:
            raise PhotographError(f"{path}: is stored turned or mirrored; save it upright")
        ends = np.add(page.dataoffsets, page.databytecounts)
        if ends.max() > path.stat().st_size:  # tifffile lets the last tile be cut short
            raise PhotographError(f"{path}: is cut short; save or copy it again")
        _check_packing(page, path)
        values = series.asarray()
        if series.axes == "SYX":
            values = np.moveaxis(values, 0, -1)
        return _split(values, path, bytes(page.tags.valueof("InterColorProfile", b"")))


def _png_header(path: Path) -> tuple[int, int, int]:
    """Return rows, columns and bit depth of a PNG file, its chunks' checksums compared."""
    import png

    with decoding(path, "PNG"):
        reader = png.Reader(bytes=path.read_bytes())  # from a stream it would ask for gigabytes
        reader.preamble()
        check_count((reader.height, reader.width, reader.planes), path)
        bits = reader.width * reader.planes * reader.bitdepth
        most = 2 * (reader.height + 8) * (bits // 8 + 8)  # interlaced ones too
        chunks = reader.chunks()  # each is compared with its checksum; the last is there
        check_unpacked((body for kind, body in chunks if kind == b"IDAT"), most, path)
        return reader.height, reader.width, reader.bitdepth


def _read_16_bit_png(path: Path) -> Picture:
    """Read by pypng: Pillow 13 still cuts 16-bit colour down to 8 bits, without a word."""
    import png

    with decoding(path, "PNG"):
        columns, rows, lines, info = png.Reader(bytes=path.read_bytes()).read()
        values = np.array([np.asarray(line, dtype=np.uint16) for line in lines])
        return _split(values.reshape(rows, columns, info["planes"]), path, _png_profile(path))


def _png_profile(path: Path) -> bytes:
    """Return the profile of a PNG file, that of sRGB where its chunk says so."""
    from PIL import Image, ImageCms

    with Image.open(path, formats=["PNG"]) as picture:
        if "srgb" in picture.info:
            return ImageCms.ImageCmsProfile(ImageCms.createProfile("sRGB")).tobytes()
        return bytes(picture.info.get("icc_profile", b""))


def _check_packing(page: Any, path: Path) -> None:
    """Refuse what is not deflate, and strips or tiles that unpack to more than they may hold."""
    import tifffile

    known = tifffile.COMPRESSION
    if page.compression == known.NONE:
        return
    if page.compression not in (known.ADOBE_DEFLATE, known.DEFLATE):
        raise PhotographError(
            f"{path}: is packed by {page.compression.name}; save it uncompressed or with deflate"
        )
    check_count(page.chunks, path)
    most = math.prod(page.chunks) * page.dtype.itemsize
    with path.open("rb") as stream:
        for offset, count in zip(page.dataoffsets, page.databytecounts, strict=True):
            stream.seek(offset)
            check_unpacked([stream.read(count)], most, path)


def _read_with_pillow(path: Path, kind: str) -> Picture:
    """Read 8 bits a channel or fewer, upright, palettes looked up."""
    from PIL import Image, ImageOps

    with decoding(path, kind), Image.open(path, formats=[kind]) as picture:
        check_count((picture.height, picture.width, len(picture.getbands())), path)
        mode = _CHANGED_MODES.get(picture.mode, picture.mode)
        if mode not in _DIRECT_MODES:
            raise PhotographError(f"{path}: has colours {picture.mode}; save it as grey or RGB")
        if "transparency" in picture.info:
            mode = {"L": "LA", "RGB": "RGBA"}.get(mode, mode)
        profile = picture.info.get("icc_profile") or b""
        return _split(np.asarray(ImageOps.exif_transpose(picture).convert(mode)), path, profile)


def _split(values: NDArray[Any], path: Path, profile: bytes = b"") -> Picture:
    """Return colour and alpha of (rows, columns[, channels]) values."""
    if values.ndim == 2:
        values = values[..., None]
    if values.ndim != 3 or not 1 <= values.shape[2] <= 4:
        raise PhotographError(f"{path}: has shape {values.shape}; save a grey or RGB picture")
    if values.shape[2] % 2:
        return Picture(values, is_display=True, profile=profile)
    return Picture(values[..., :-1], values[..., -1:], is_display=True, profile=profile)
