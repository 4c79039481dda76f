"""PNG, TIFF and JPEG files, read at the bit depth they were saved with."""

from __future__ import annotations

import logging
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from periscopy_sim.errors import PhotographError
from periscopy_sim.storage.formats.decoding import GAMMA, LINEAR, SRGB, Picture, decoding

_PROFILE = "a colour profile of deep integers"
_MODES = ("1", "L", "LA", "P", "PA", "RGB", "RGBA")  # of Pillow: grey, palettes, RGB

logging.getLogger("tifffile").addHandler(logging.NullHandler())  # what is wrong is an error here


def read_png(path: Path, key: str) -> Picture:
    """Read a PNG file without changing its bit depth."""
    import png  # Pillow cuts 16-bit colour down to 8 bits, without a word
    from PIL import ExifTags, Image

    with decoding(path, "PNG"):
        content = path.read_bytes()
        chunks = dict(png.Reader(bytes=content).chunks())
        encoding = None if key == "mask" else _png_encoding(chunks, path)
        if chunks[b"IHDR"][8] < 16:
            return read_8_bits(path, key, "PNG", encoding)
        exif = Image.Exif()
        exif.load(chunks.get(b"eXIf", b""))
        if exif.get(ExifTags.Base.Orientation, 1) != 1:
            raise _unread(path, "a turned picture of 16 bits")
        if b"tRNS" in chunks:
            raise _unread(path, "a transparent colour of 16 bits")
        columns, rows, lines, info = png.Reader(bytes=content).read()
        values = np.array([np.asarray(line, dtype=np.uint16) for line in lines])
        return _picture(values.reshape(rows, columns, info["planes"]), path, encoding)


def read_tiff(path: Path, key: str) -> Picture:
    """Read by tifffile, which keeps 16-bit and floating-point values; 8 bits by Pillow."""
    import tifffile

    remedy = "save it again, uncompressed or with deflate compression"
    with decoding(path, "TIFF", remedy), tifffile.TiffFile(path) as file:
        series, page = file.series[0], file.pages.first
        is_deep = page.dtype not in (np.uint8, np.bool_)
        if (count := len(file.series if is_deep else file.pages)) != 1:
            raise _unread(path, f"a file of {count} pictures")
        if page.tags.valueof("Orientation", 1) != 1:
            raise _unread(path, "a turned picture")
        if not is_deep:
            return read_8_bits(path, key, "TIFF")
        if page.photometric not in (tifffile.PHOTOMETRIC.MINISBLACK, tifffile.PHOTOMETRIC.RGB):
            raise _unread(path, page.photometric.name)
        if {*page.extrasamples} - {tifffile.EXTRASAMPLE.UNASSALPHA}:
            raise _unread(path, "a fourth channel other than straight alpha")
        if "GDAL_NODATA" in page.tags:
            raise _unread(path, "a value that stands for none (GDAL_NODATA)")
        # Deflate packs up to 1032 bytes in one: of more, tifffile would fill the memory.
        if not reaches_its_pixels(file, path) or series.nbytes > 1032 * path.stat().st_size:
            raise PhotographError(f"{path}: is cut short or damaged; save or copy it again")
        values = series.asarray()
        if series.axes == "SYX":
            values = np.moveaxis(values, 0, -1)
        curves = any(name in page.tags for name in ("InterColorProfile", "TransferFunction"))
        if key != "mask" and values.dtype.kind == "u" and curves:
            raise _unread(path, _PROFILE)
        return _picture(values, path)


def read_8_bits(path: Path, _: str, kind: str = "JPEG", encoding: str | None = None) -> Picture:
    """Read a file of 8 bits a channel or fewer, by Pillow, upright, palettes looked up."""
    from PIL import Image, ImageOps

    with decoding(path, kind), Image.open(path, formats=[kind]) as picture:
        if picture.mode not in _MODES:
            raise _unread(path, picture.mode)
        mode = "RGBA" if picture.has_transparency_data else "RGB"
        return _picture(np.asarray(ImageOps.exif_transpose(picture).convert(mode)), path, encoding)


def reaches_its_pixels(file: Any, path: Path) -> bool:
    """Return whether a TIFF file, open by tifffile, holds all its pixels; decoders let it pass."""
    parts = [part for page in file.pages for part in (page, *(page.pages or ()))]
    ends = [np.add(part.dataoffsets, part.databytecounts).max(initial=0) for part in parts]
    return bool(max(ends) <= path.stat().st_size)


def _png_encoding(chunks: Mapping[bytes, bytes], path: Path) -> str | None:
    """Return the encoding that PNG's chunks declare, the first that counts (PNG 3, 4.3)."""
    if b"cICP" in chunks:
        raise _unread(path, "a cICP chunk")
    if b"iCCP" in chunks:
        if chunks[b"IHDR"][8] == 16:
            raise _unread(path, _PROFILE)
        return SRGB  # nearly, as most profiles of 8 bits are; the reader warns
    if b"sRGB" in chunks:
        return SRGB
    known = {1: LINEAR, 0.455: GAMMA, 0: None}
    gamma = int.from_bytes(chunks.get(b"gAMA", b"")) / 1e5
    if round(gamma, 3) not in known:
        raise _unread(path, f"gamma {gamma}")
    return known[round(gamma, 3)]


def _unread(path: Path, what: str) -> PhotographError:
    return PhotographError(
        f"{path}: {what} is not supported; save one upright picture, grey or RGB: linear light as "
        "floating-point TIFF or EXR, or as 16 bits without a profile"
    )


def _picture(values: NDArray[Any], path: Path, encoding: str | None = None) -> Picture:
    """Return colour and alpha of (rows, columns[, channels]) values."""
    if values.ndim == 2:
        values = values[..., None]
    if values.ndim != 3 or not 1 <= values.shape[2] <= 4:
        raise PhotographError(f"{path}: has shape {values.shape}; save a grey or RGB picture")
    colours = values.shape[2] - 1 if values.shape[2] % 2 == 0 else values.shape[2]
    alpha = values[..., colours:] if colours < values.shape[2] else None
    return Picture(values[..., :colours], alpha, is_display=True, encoding=encoding)
