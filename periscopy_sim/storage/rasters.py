"""Decoders of pictures: PNG, TIFF and others of 8 and 16 bits, raw files of cameras, OpenEXR.

Every failure of a decoder is one error. Each 2 x 2 cell of a raw file's Bayer mosaic becomes one
pixel: its red, its blue and the mean of its two greens. Nothing is interpolated, as demosaicing
would, so noise stays white; there is no white balance, no colour matrix and no gamma.
"""

import logging
import struct
from collections.abc import Iterator, Mapping, Sequence
from contextlib import contextmanager, suppress
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from periscopy_sim.errors import PhotographError, path_fault, require
from periscopy_sim.numerics.validation import MOST_BYTES, check_budget, read_regular
from periscopy_sim.storage.outputs import staged_file

LINEAR, SRGB, GAMMA = "linear", "sRGB", "gamma 1/2.2"
"""Encodings that a file may declare; converters write the last for linear light, too."""


@dataclass(frozen=True, eq=False)
class Picture:
    """What a file holds, as it was saved; row 0 is the top."""

    values: NDArray[Any]  # (rows, columns[, channels]) of any real dtype
    alpha: NDArray[Any] | None = None  # opacity, (rows, columns, 1) of that dtype
    left_out: tuple[str, ...] = ()  # other channels of the file
    unapplied: tuple[str, ...] = ()  # tags of corrections that the file asks for
    is_display: bool = False  # made for screens: integers may be encoded by the sRGB curve
    encoding: str | None = None  # what the file declares of its integers
    saturated: NDArray[np.bool_] | None = None  # (rows, columns), where its sensor says it was
    cell: int = 1  # pixels of the sensor along each side of one of these
    metadata: Mapping[str, str | float] = field(default_factory=dict)  # of OpenEXR's header


def listed(names: Sequence[str]) -> str:
    """Return the first four names for a message, and the number of the others."""
    rest = f" and {len(names) - 4} more" if len(names) > 4 else ""
    return ", ".join(names[:4]) + rest


@contextmanager
def decoding(path: str | Path, kind: str, remedy: str = "save or copy it again") -> Iterator[None]:
    """Raise whatever a decoder raises in the block as a `PhotographError`.

    The message names the file, the `kind` of its format, the reason and the `remedy`.
    """
    if fault := path_fault(path):
        raise PhotographError(f"{path}: {fault}")
    try:
        yield
    except PhotographError:
        raise
    except Exception as error:  # damaged bytes raise all kinds of exceptions
        text = getattr(error, "strerror", None) or str(error)
        reason = (text.splitlines() or [""])[0] or type(error).__name__
        raise PhotographError(f"{path}: cannot be read as {kind}: {reason}; {remedy}") from error


def srgb_encode(linear: ArrayLike) -> NDArray[np.float64]:
    """Return linear light, nominally in [0, 1], encoded; negatives follow the straight piece."""
    linear = np.asarray(linear, dtype=np.float64)
    power = 1.055 * np.maximum(linear, 0.0031308) ** (1 / 2.4) - 0.055
    return np.where(linear <= 0.0031308, 12.92 * linear, power)


def srgb_bytes(linear: ArrayLike) -> NDArray[np.uint8]:
    """Return linear light, clipped to [0, 1], as 8-bit sRGB values."""
    return np.rint(255 * srgb_encode(np.clip(linear, 0, 1))).astype(np.uint8)


def srgb_decode(encoded: ArrayLike) -> NDArray[np.float64]:
    """Return the linear light of sRGB values, nominally in [0, 1]; `srgb_encode` undone."""
    encoded = np.asarray(encoded, dtype=np.float64)
    power = ((np.maximum(encoded, 0.04045) + 0.055) / 1.055) ** 2.4
    return np.where(encoded <= 0.04045, encoded / 12.92, power)


def srgb_light(codes: NDArray[np.unsignedinteger]) -> NDArray[np.float64]:
    """Return the linear light of 8- or 16-bit sRGB values, 1 for the largest, by a table."""
    white = np.iinfo(codes.dtype).max
    return np.asarray(srgb_decode(np.arange(white + 1) / white)[codes])


NAMES = {1: "Y", 3: "RGB"}
"""Names of the channels of an image, by how many it has."""


def write_exr(path: Path, image: ArrayLike, metadata: Mapping[str, str | float]) -> None:
    """Write a float32 image of linear light: (rows, columns, 3) RGB or (rows, columns, 1) grey.

    The same inputs give the same bytes. The metadata are text, and numbers at double precision,
    under names that OpenEXR itself does not use. Another shape of the image is a ValueError.
    """
    import OpenEXR

    pixels = np.asarray(image, dtype=np.float32)
    if pixels.ndim != 3 or pixels.shape[2] not in NAMES or pixels.size == 0:
        raise ValueError(f"image: expected (rows, columns, 1 or 3), got {pixels.shape}")
    header = {
        # In an array: a Python float would lose its double precision.
        **{n: v if isinstance(v, str) else np.array([v], np.float64) for n, v in metadata.items()},
        "compression": OpenEXR.ZIP_COMPRESSION,
        "type": OpenEXR.scanlineimage,
    }
    # OpenEXR ignores strides: each channel must be contiguous.
    channels = {
        c: np.ascontiguousarray(pixels[..., i]) for i, c in enumerate(NAMES[pixels.shape[2]])
    }
    with staged_file(path) as staged, OpenEXR.File(header, channels) as file:
        file.write(str(staged))


def read_exr(path: Path) -> tuple[NDArray[np.float32], dict[str, str | float]]:
    """Read an image of `write_exr`, or the colour of any flat OpenEXR file, and the metadata.

    The image is (rows, columns, 3) float32 linear light; a lone grey channel is replicated.
    """
    picture = decode_exr(path)
    shape = (*picture.values.shape[:2], 3)
    return np.broadcast_to(picture.values, shape).astype(np.float32), dict(picture.metadata)


def decode_exr(path: Path, _: str = "") -> Picture:
    """Read R, G and B of an OpenEXR file of one flat part, or its only channel."""
    import OpenEXR

    with decoding(path, "EXR"):
        with OpenEXR.File(str(path), header_only=True) as file:
            count, head = len(file.parts), file.parts[0].header
            low, high = head["dataWindow"]
            columns, rows = (int(side) + 1 for side in np.subtract(high, low, dtype=np.int64))
            check_budget((rows, columns, len(head["channels"])), path)
        with OpenEXR.File(str(path), separate_channels=True) as file:
            if not file.parts:  # so OpenEXR reports pixels that it cannot read
                raise ValueError("its pixels are cut short or damaged")
            header, channels = file.parts[0].header, file.parts[0].channels
            if count > 1 or header["type"].name not in ("scanlineimage", "tiledimage"):
                raise PhotographError(f"{path}: has several parts or is deep; save one flat image")
            if not np.array_equal(header["dataWindow"], header["displayWindow"]):
                raise PhotographError(f"{path}: holds a crop of its picture; save all of it")
            names = [name for name in channels if name != "A"]
            colour = [*"RGB"] if {*"RGB"} <= {*names} else names
            if colour != [*"RGB"] and len(colour) != 1:
                raise PhotographError(f"{path}: has {listed(names)}; save R, G and B alone")
            pixels = np.stack([channels[name].pixels for name in colour], axis=-1)
            left_out = tuple(name for name in channels if name not in colour)
            # Doubles come in arrays.
            values = {n: v.item() if np.size(v) == 1 and isinstance(v, np.ndarray) else v
                      for n, v in header.items()}  # fmt: skip
            metadata = {n: v for n, v in values.items() if isinstance(v, str | float | int)}
            return Picture(pixels, left_out=left_out, metadata=metadata)


_PROFILE = "a colour profile of deep integers"
_MODES = ("1", "L", "LA", "P", "PA", "RGB", "RGBA")  # of Pillow: grey, palettes, RGB

logging.getLogger("tifffile").addHandler(logging.NullHandler())  # what is wrong is an error here


def read_png(path: Path, key: str) -> Picture:
    """Read a PNG file without changing its bit depth."""
    import png  # Pillow cuts 16-bit colour down to 8 bits, without a word
    from PIL import ExifTags, Image

    with decoding(path, "PNG"):
        content = read_regular(path, MOST_BYTES)
        chunks = dict(png.Reader(bytes=content).chunks())
        columns, rows = struct.unpack(">II", chunks[b"IHDR"][:8])
        check_budget((rows, columns), path)
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
        if "GDAL_NODATA" in page.tags:
            raise _unread(path, "a value that stands for none (GDAL_NODATA)")
        if not is_deep:
            return read_8_bits(path, key, "TIFF")
        if page.photometric not in (tifffile.PHOTOMETRIC.MINISBLACK, tifffile.PHOTOMETRIC.RGB):
            raise _unread(path, page.photometric.name)
        if {*page.extrasamples} - {tifffile.EXTRASAMPLE.UNASSALPHA}:
            raise _unread(path, "a fourth channel other than straight alpha")
        if not reaches_its_pixels(file, path):
            raise PhotographError(f"{path}: is cut short or damaged; save or copy it again")
        rows, columns = series.shape[-2:] if series.axes in ("YX", "SYX") else series.shape[:2]
        check_budget((rows, columns, page.samplesperpixel), path)
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
        check_budget(picture.size[::-1], path)
        mode = "RGBA" if picture.has_transparency_data else "RGB"
        return _picture(np.asarray(ImageOps.exif_transpose(picture).convert(mode)), path, encoding)


def reaches_its_pixels(file: Any, path: Path) -> bool:
    """Return whether a TIFF file, open by tifffile, holds all its pixels; decoders let it pass."""
    ends = [np.add(each.dataoffsets, each.databytecounts).max(initial=0) for each in _pages(file)]
    return bool(max(ends) <= path.stat().st_size)


def _pages(file: Any) -> list[Any]:
    return [each for page in file.pages for each in (page, *(page.pages or ()))]


def _png_encoding(chunks: Mapping[bytes, bytes], path: Path) -> str | None:
    """Return the encoding that PNG's chunks declare, the first that counts (PNG 3, 4.3)."""
    if b"cICP" in chunks:
        raise _unread(path, "a cICP chunk")
    if b"iCCP" in chunks:
        if chunks[b"IHDR"][8] == 16:
            raise _unread(path, _PROFILE)
        return SRGB  # Treat 8-bit profiles as sRGB; the reader warns.
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


RAW_SUFFIXES = (
    ".dng", ".nef", ".nrw", ".arw", ".srf", ".sr2", ".cr2", ".cr3", ".pef", ".raf", ".orf", ".rw2",
    ".srw", ".3fr", ".erf", ".iiq", ".mef", ".mos", ".kdc", ".dcr", ".rwl",
)  # fmt: skip

RAW_SIGNATURE = rb"II\*\x00|MM\x00\*|.{4}ftypcrx |FUJIFILMCCD-RAW|IIRO|IIRS|MMOR|IIU\x00"
"""Mostly TIFF's; the others are Canon's CR3, Fujifilm's, Olympus', and Panasonic's."""

OPCODE_LISTS = 51008, 51009, 51022
"""Tags of DNG that list corrections, first their number; LibRaw applies none."""


def read_camera_raw(path: Path, _: str) -> Picture:
    """Read a camera's raw file as counts above its black level, half the mosaic's size."""
    rawpy = require("rawpy")
    import tifffile

    is_whole, unapplied = True, dict[str, None]()
    with suppress(Exception), tifffile.TiffFile(path) as file:
        is_whole = reaches_its_pixels(file, path)
        for page in _pages(file):
            lists = (page.tags[code] for code in OPCODE_LISTS if code in page.tags)
            unapplied |= dict.fromkeys(each.name for each in lists if any(each.value[:4]))
    with decoding(path, "camera raw"), rawpy.imread(str(path)) as raw:
        if not is_whole:  # LibRaw would fill what is cut off
            raise ValueError("it is cut short")
        cell = 1 if raw.num_colors == 1 else 2
        check_budget((raw.sizes.height // cell, raw.sizes.width // cell), path)
        light, flip = raw.raw_image_visible.astype(np.float32), raw.sizes.flip
        full = raw.raw_image_visible >= raw.white_level
        black, colours = raw.black_level_per_channel, raw.raw_colors_visible
        if cell == 1:
            light = light[..., np.newaxis] - np.float32(black[0])
        else:
            places = [chr(raw.color_desc[index]) for index in colours[:2, :2].ravel()]
            even = (colours[2:] == colours[:-2]).all() and (colours[:, 2:] == colours[:, :-2]).all()
            if not even or sorted(places) != ["B", "G", "G", "R"]:
                raise PhotographError(
                    f"{path}: its mosaic is no Bayer pattern of red, green and blue; export it as "
                    "16-bit linear TIFF"
                )
            for k, index in enumerate(colours[:2, :2].ravel()):
                light[k // 2 :: 2, k % 2 :: 2] -= np.float32(black[index])
            light = bayer_colours(light, places)
            whole = full[: 2 * light.shape[0], : 2 * light.shape[1]]
            full = whole[::2, ::2] | whole[::2, 1::2] | whole[1::2, ::2] | whole[1::2, 1::2]
    upright, full = _upright(light, flip), _upright(full, flip)
    return Picture(upright, unapplied=(*unapplied,), saturated=full, cell=cell)


XYZ_FROM_SRGB = np.array(  # IEC 61966-2-1
    [[0.4124, 0.3576, 0.1805], [0.2126, 0.7152, 0.0722], [0.0193, 0.1192, 0.9505]]
)


def raw_colours(path: Path) -> NDArray[np.float64]:
    """Read the matrix, (3, 3), from sRGB primaries to the counts of a camera's raw file.

    LibRaw has it from XYZ where it knows the camera. Of other files, as most DNG, it inverts what
    they state, with rows of sum 1, and has the inverse sums as the gains for daylight.
    """
    rawpy = require("rawpy")
    with decoding(path, "camera raw"), rawpy.imread(str(path)) as raw:
        from_xyz = np.asarray(raw.rgb_xyz_matrix[:3], np.float64)
        if raw.num_colors == 3 and from_xyz.any():
            return np.asarray(from_xyz @ XYZ_FROM_SRGB, np.float64)
        balanced, gains = raw.color_matrix[:, :3], np.array(raw.daylight_whitebalance[:3])
        stated = balanced.any() and not np.allclose(balanced, np.eye(3)) and gains.all()
        if raw.num_colors != 3 or not stated:
            raise PhotographError(
                f"{path}: states no colours of its camera; give a matrix of 3 x 3 numbers"
            )
        return np.asarray(np.linalg.inv(balanced) / gains[:, np.newaxis], np.float64)


def bayer_colours(counts: NDArray[Any], places: Sequence[str] = "RGGB") -> NDArray[Any]:
    """Return half-size colours, (rows, columns, 3), of (2 rows, 2 columns) Bayer counts.

    `places` are the colours of a cell, row-major; its two greens are averaged.
    """
    rows, columns = counts.shape[0] // 2, counts.shape[1] // 2
    colours = np.zeros((rows, columns, 3), np.result_type(counts, np.float32))
    for k, letter in enumerate(places):
        cells = counts[k // 2 : 2 * rows : 2, k % 2 : 2 * columns : 2]
        colours[..., "RGB".index(letter)] += cells / places.count(letter)
    return colours


def _upright(image: NDArray[Any], flip: int) -> NDArray[Any]:
    """Return a (rows, columns, ...) image as it is to be seen.

    The bits of LibRaw's `flip` reverse the columns, reverse the rows, and exchange both.
    """
    turned = image[:: -1 if flip & 2 else 1, :: -1 if flip & 1 else 1]
    return turned.swapaxes(0, 1) if flip & 4 else turned
