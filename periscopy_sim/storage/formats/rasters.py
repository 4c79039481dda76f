"""PNG, TIFF and JPEG files, read at the bit depth they were saved with, upright."""

from __future__ import annotations

import io
import logging
import zlib
from collections.abc import Mapping
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from periscopy_sim.errors import PhotographError
from periscopy_sim.storage.formats.arrays import PHOTOGRAPH
from periscopy_sim.storage.formats.decoding import (
    GAMMA,
    LINEAR,
    SRGB,
    Picture,
    decoding,
    upright,
)
from periscopy_sim.storage.formats.srgb import srgb_encode

CLOSE = 3
"""Of 255: profiles round their curves."""

STEEP = 32
"""Of 255: LittleCMS limits the slope of a linear profile's curve to sRGB below."""

MOST_VALUES = 2**28
"""Of a TIFF file: with a damaged size, tifffile would fill the memory for minutes."""

_MODES = ("1", "L", "LA", "P", "PA", "RGB", "RGBA")  # of Pillow: grey, palettes, RGB
_FLIPS = (0, 0, 1, 3, 2, 4, 6, 7, 5)  # by EXIF's orientation, 1 to 8; see `upright`
_ORIENTATION = 274

logging.getLogger("tifffile").addHandler(logging.NullHandler())  # what is wrong is an error here


def read_png(path: Path, key: str) -> Picture:
    """Read a PNG file without changing its bit depth."""
    import png  # Pillow cuts 16-bit colour down to 8 bits, without a word
    from PIL import Image

    with decoding(path, "PNG"):
        content = path.read_bytes()
        chunks = dict(png.Reader(bytes=content).chunks())
        encoding = _png_encoding(chunks, path) if key == PHOTOGRAPH else None
        if chunks[b"IHDR"][8] < 16:
            return read_8_bits(path, key, "PNG", encoding)
        columns, rows, lines, info = png.Reader(bytes=content).read()
        values = np.array([np.asarray(line, dtype=np.uint16) for line in lines])
        exif = Image.Exif()
        exif.load(chunks.get(b"eXIf", b""))
        image = upright(values.reshape(rows, columns, info["planes"]), _flip_of(exif))
        return _picture(image, path, encoding)


def read_tiff(path: Path, key: str) -> Picture:
    """Read by tifffile, which keeps 16-bit and floating-point values; 8 bits by Pillow."""
    import tifffile

    remedy = "save it again, uncompressed or with deflate compression"
    with decoding(path, "TIFF", remedy), tifffile.TiffFile(path) as file:
        series, page = file.series[0], file.pages.first
        is_deep = page.dtype not in (np.uint8, np.bool_)
        count = len(file.series if is_deep else file.pages)
        if count != 1:
            raise PhotographError(f"{path}: holds {count} pictures; save one alone")
        flip = _flip_of({_ORIENTATION: page.tags.valueof("Orientation", 1)})
        if not is_deep and flip & 4:  # Pillow 13 scrambles some
            raise PhotographError(f"{path}: is stored turned by 90 degrees; save it upright")
        if not is_deep:
            return read_8_bits(path, key, "TIFF")
        if page.photometric not in (tifffile.PHOTOMETRIC.MINISBLACK, tifffile.PHOTOMETRIC.RGB):
            raise PhotographError(f"{path}: is {page.photometric.name}; save it as grey or RGB")
        if tifffile.EXTRASAMPLE.ASSOCALPHA in page.extrasamples:
            raise PhotographError(f"{path}: has premultiplied alpha; save it as grey or RGB")
        if not reaches_its_pixels(file, path):
            raise PhotographError(f"{path}: is cut short; save or copy it again")
        if series.size > MOST_VALUES:
            raise PhotographError(f"{path}: {series.shape} values are too many, or damaged")
        values = series.asarray()
        if series.axes == "SYX":
            values = np.moveaxis(values, 0, -1)
        profile = bytes(page.tags.valueof("InterColorProfile", b""))
        is_integer = key == PHOTOGRAPH and values.dtype == np.uint16
        encoding = encoding_of(profile, path) if profile and is_integer else None
        picture = _picture(upright(values, flip), path, encoding)
        is_named = tifffile.EXTRASAMPLE.UNSPECIFIED not in page.extrasamples
        return picture if is_named else replace(picture, alpha=None, left_out=("extra",))


def reaches_its_pixels(file: Any, path: Path) -> bool:
    """Return whether a TIFF file, open by tifffile, holds all its pixels; decoders let it pass."""
    parts = [part for page in file.pages for part in (page, *(page.pages or ()))]
    ends = [np.add(part.dataoffsets, part.databytecounts).max(initial=0) for part in parts]
    return bool(max(ends) <= path.stat().st_size)


def encoding_of(profile: bytes, path: Path) -> str:
    """Return `LINEAR` or `SRGB`, the encoding of greys by an ICC profile.

    LittleCMS takes a grey ramp through the profile to sRGB. The ramp stays as it is if the
    profile's curve is sRGB's, and becomes encoded if the profile is linear. A `PhotographError`
    names another profile, or one that cannot be read.
    """
    from PIL import Image, ImageCms

    with decoding(path, "a picture with a colour profile", "save it without one, as linear light"):
        opened = ImageCms.ImageCmsProfile(io.BytesIO(profile))
        name = ImageCms.getProfileDescription(opened).strip()
        mode = "L" if opened.profile.xcolor_space.strip() == "GRAY" else "RGB"
        to_srgb = ImageCms.buildTransform(opened, ImageCms.createProfile("sRGB"), mode, "RGB")
        ramp = np.arange(256, dtype=np.uint8)
        grey = Image.fromarray(ramp[None]).convert(mode)
        shown = np.asarray(ImageCms.applyTransform(grey, to_srgb), np.float64)[0].mean(axis=1)
    if np.abs(shown - ramp).max() <= CLOSE:
        return SRGB
    if np.abs(shown - 255 * srgb_encode(ramp / 255))[STEEP:].max() <= CLOSE:
        return LINEAR
    raise _unknown(f"colour profile '{name}'", path)


def _png_encoding(chunks: Mapping[bytes, bytes], path: Path) -> str | None:
    """Return the encoding that the first of PNG's four chunks for it declares (PNG 3, 4.3)."""
    if coding := chunks.get(b"cICP"):
        known, value = {8: LINEAR, 13: SRGB}, coding[1]  # transfer functions of ITU-T H.273
        name = f"cICP transfer function {value}"
    elif profile := chunks.get(b"iCCP"):
        return encoding_of(zlib.decompress(profile[profile.index(b"\0") + 2 :]), path)
    elif b"sRGB" in chunks:
        return SRGB
    elif gamma := chunks.get(b"gAMA"):
        known, value = {100_000: LINEAR, 45_455: GAMMA}, int.from_bytes(gamma)
        name = f"gamma {value / 1e5}"
    else:
        return None
    if value not in known:
        raise _unknown(name, path)
    return known[value]


def _unknown(encoding: str, path: Path) -> PhotographError:
    return PhotographError(
        f"{path}: its {encoding} is neither linear nor sRGB's; export it with a linear profile, or "
        "with none and linear values"
    )


def _flip_of(exif: Mapping[int, Any]) -> int:
    orientation = exif.get(_ORIENTATION, 1)
    return _FLIPS[orientation] if orientation in range(9) else 0


def read_8_bits(path: Path, key: str, kind: str = "JPEG", encoding: str | None = None) -> Picture:
    """Read a file of 8 bits a channel or fewer, by Pillow, palettes looked up."""
    from PIL import Image, ImageOps

    with decoding(path, kind), Image.open(path, formats=[kind]) as picture:
        if picture.mode not in _MODES:
            raise PhotographError(f"{path}: has colours {picture.mode}; save it as grey or RGB")
        profile = picture.info.get("icc_profile")
        if profile and not encoding and key == PHOTOGRAPH:
            encoding = encoding_of(profile, path)
        mode = "RGBA" if picture.has_transparency_data else "RGB"
        values = np.asarray(ImageOps.exif_transpose(picture).convert(mode))
        return _picture(values, path, encoding)


def _picture(values: NDArray[Any], path: Path, encoding: str | None) -> Picture:
    """Return colour and alpha of (rows, columns[, channels]) values."""
    if values.ndim == 2:
        values = values[..., None]
    if values.ndim != 3 or not 1 <= values.shape[2] <= 4:
        raise PhotographError(f"{path}: has shape {values.shape}; save a grey or RGB picture")
    if values.shape[2] % 2:
        return Picture(values, is_display=True, encoding=encoding)
    return Picture(values[..., :-1], values[..., -1:], is_display=True, encoding=encoding)
