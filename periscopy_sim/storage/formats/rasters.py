"""PNG, TIFF and JPEG files, read at the bit depth they were saved with."""

from __future__ import annotations

import io
import logging
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from periscopy_sim.errors import PhotographError
from periscopy_sim.storage.formats.decoding import Picture, decoding
from periscopy_sim.storage.formats.srgb import srgb_encode

LINEAR, SRGB = "linear", "sRGB"

CLOSE = 3
"""Of 255: profiles round their curves."""

MOST_VALUES = 2**28
"""Of a TIFF file: with a damaged size, tifffile would fill the memory for minutes."""

STEEP = 32
"""Of 255: LittleCMS limits the slope of a linear profile's curve to sRGB below."""

_DIRECT_MODES = ("L", "LA", "RGB", "RGBA")  # of Pillow; others are converted:
_CHANGED_MODES = {"1": "L", "P": "RGB", "PA": "RGBA"}

logging.getLogger("tifffile").addHandler(logging.NullHandler())  # what is wrong is an error here


def read_png(path: Path, *_: object) -> Picture:
    """Read a PNG file without changing its bit depth."""
    with path.open("rb") as stream:
        depth = stream.read(25)[24:]
    if depth != b"\x10":
        return _read_with_pillow(path, "PNG")
    import png  # Pillow cuts 16-bit colour down to 8 bits, without a word

    with decoding(path, "PNG"):
        columns, rows, lines, info = png.Reader(bytes=path.read_bytes()).read()
        values = np.array([np.asarray(line, dtype=np.uint16) for line in lines])
        return _picture(values.reshape(rows, columns, info["planes"]), path, _png_profile(path))


def read_jpeg(path: Path, *_: object) -> Picture:
    """Read a JPEG file, grey or RGB."""
    return _read_with_pillow(path, "JPEG")


def read_tiff(path: Path, *_: object) -> Picture:
    """Read by tifffile, which keeps 16-bit and floating-point values; 8 bits by Pillow."""
    import tifffile

    remedy = "save it again, uncompressed or with deflate compression"
    with decoding(path, "TIFF", remedy), tifffile.TiffFile(path) as file:
        series, page = file.series[0], file.pages.first
        is_deep = page.dtype not in (np.uint8, np.bool_)
        count = len(file.series if is_deep else file.pages)
        if count != 1:
            raise PhotographError(f"{path}: holds {count} pictures; save one alone")
        if not is_deep:
            return _read_with_pillow(path, "TIFF")
        if page.photometric not in (tifffile.PHOTOMETRIC.MINISBLACK, tifffile.PHOTOMETRIC.RGB):
            raise PhotographError(f"{path}: is {page.photometric.name}; save it as grey or RGB")
        if page.tags.valueof("Orientation", 1) != 1:
            raise PhotographError(f"{path}: is stored turned or mirrored; save it upright")
        check_whole(file, path)
        if series.size > MOST_VALUES:
            raise PhotographError(f"{path}: {series.shape} values are too many, or damaged")
        values = series.asarray()
        if series.axes == "SYX":
            values = np.moveaxis(values, 0, -1)
        return _picture(values, path, bytes(page.tags.valueof("InterColorProfile", b"")))


def check_whole(file: Any, path: Path) -> None:
    """Raise if a TIFF file, open by tifffile, ends before its pixels do: decoders let it pass."""
    parts = [part for page in file.pages for part in (page, *(page.pages or ()))]
    ends = [np.add(part.dataoffsets, part.databytecounts).max(initial=0) for part in parts]
    if max(ends) > path.stat().st_size:
        raise PhotographError(f"{path}: is cut short; save or copy it again")


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
    raise PhotographError(
        f"{path}: its colour profile '{name}' encodes light by a curve other than sRGB's; export "
        "it with a linear profile, or with none and linear values"
    )


def _png_profile(path: Path) -> bytes:
    """Return the profile of a PNG file, that of sRGB if its sRGB chunk says so."""
    from PIL import Image, ImageCms

    with Image.open(path, formats=["PNG"]) as picture:
        if "srgb" in picture.info:
            return ImageCms.ImageCmsProfile(ImageCms.createProfile("sRGB")).tobytes()
        return bytes(picture.info.get("icc_profile", b""))


def _read_with_pillow(path: Path, kind: str) -> Picture:
    """Read 8 bits a channel or fewer, upright, palettes looked up."""
    from PIL import Image, ImageOps

    with decoding(path, kind), Image.open(path, formats=[kind]) as picture:
        mode = _CHANGED_MODES.get(picture.mode, picture.mode)
        if mode not in _DIRECT_MODES:
            raise PhotographError(f"{path}: has colours {picture.mode}; save it as grey or RGB")
        if "transparency" in picture.info:
            mode = {"L": "LA", "RGB": "RGBA"}.get(mode, mode)
        profile = picture.info.get("icc_profile") or b""
        return _picture(np.asarray(ImageOps.exif_transpose(picture).convert(mode)), path, profile)


def _picture(values: NDArray[Any], path: Path, profile: bytes) -> Picture:
    """Return colour and alpha of (rows, columns[, channels]) values."""
    if values.ndim == 2:
        values = values[..., None]
    if values.ndim != 3 or not 1 <= values.shape[2] <= 4:
        raise PhotographError(f"{path}: has shape {values.shape}; save a grey or RGB picture")
    if values.shape[2] % 2:
        return Picture(values, is_display=True, profile=profile)
    return Picture(values[..., :-1], values[..., -1:], is_display=True, profile=profile)
