"""OpenEXR images with metadata."""

from __future__ import annotations

import math
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from periscopy_sim.errors import PhotographError
from periscopy_sim.storage.formats.decoding import check_count, decoding, listed, place_of
from periscopy_sim.storage.outputs.staging import staged_file

_STRUCTURAL = {  # attributes that describe the pixels, which metadata must not replace
    *("channels", "chunkCount", "compression", "dataWindow", "deepImageState", "displayWindow"),
    *("lineOrder", "maxSamplesPerPixel", "name", "pixelAspectRatio", "screenWindowCenter"),
    *("screenWindowWidth", "tiles", "type", "version", "view"),
}
_LONGEST_NAME = 255  # characters, "long names" in the OpenEXR file layout
_FLAT = ("scanlineimage", "tiledimage")


@dataclass(frozen=True)
class ExrPart:
    """What the header of a part of an OpenEXR file tells."""

    name: str  # empty where it has none
    size: tuple[int, int]  # rows, columns
    colour: tuple[str, ...]  # its channels of colour, or the grey one
    left_out: tuple[str, ...]  # its other channels
    metadata: dict[str, str | float]  # what is text or numbers and does not describe the pixels

    @property
    def count(self) -> int:
        """Number of values."""
        return math.prod(self.size) * len((*self.colour, *self.left_out))


def write_exr(path: Path, image: ArrayLike, metadata: Mapping[str, str | float]) -> None:
    """Write a float32 RGB image, (rows, columns, 3) linear light.

    The same inputs give the same bytes. The metadata are text, and numbers at double precision.
    Another shape of the image is a ValueError, and so is a name that is empty, over 255 characters
    long or one that OpenEXR itself uses, such as `compression`.
    """
    import OpenEXR

    pixels = np.asarray(image, dtype=np.float32)
    if pixels.ndim != 3 or pixels.shape[2] != 3 or pixels.size == 0:
        raise ValueError(f"image: expected shape (rows, columns, 3), got {pixels.shape}")
    for name in metadata:
        if name in _STRUCTURAL or not 0 < len(name.encode()) <= _LONGEST_NAME:
            raise ValueError(f"metadata: '{name}' cannot name an attribute; choose another name")
    header = {
        "compression": OpenEXR.ZIP_COMPRESSION,
        "type": OpenEXR.scanlineimage,
        # In an array: a Python float would lose its double precision.
        **{n: v if isinstance(v, str) else np.array([v], np.float64) for n, v in metadata.items()},
    }
    # OpenEXR ignores strides: each channel must be contiguous.
    channels = {c: np.ascontiguousarray(pixels[..., i]) for i, c in enumerate("RGB")}
    with staged_file(path) as staged, OpenEXR.File(header, channels) as file:
        file.write(str(staged))


def read_exr(path: Path) -> tuple[NDArray[np.float32], dict[str, str | float]]:
    """Read an image of `write_exr`, or the colour of any flat OpenEXR file, and the metadata.

    The image is (rows, columns, 3) float32 linear light; a lone grey channel is replicated.
    """
    colour, part = decode_exr(path)
    return np.broadcast_to(colour, (*part.size, 3)).astype(np.float32), part.metadata


def decode_exr(path: Path) -> tuple[NDArray[Any], ExrPart]:
    """Read the colour channels of an OpenEXR file of one flat part, and what its header tells.

    They are linear light, (rows, columns, 1 or 3) of float16, float32 or uint32: red, green, blue,
    or grey alone.
    """
    parts = exr_parts(path)
    if len(parts) != 1:
        raise PhotographError(f"{path}: has {len(parts)} parts; save one image alone")
    (colour,) = exr_pixels(path, parts)
    return colour, parts[0]


def exr_parts(path: Path) -> list[ExrPart]:
    """Read and check the headers of an OpenEXR file.

    Of each part the channels R, G, B are taken, in whatever layer they are, else a lone Y or the
    only channel. Deep or subsampled parts and ambiguous colour are refused.
    """
    import OpenEXR

    with decoding(path, "EXR"), OpenEXR.File(str(path), header_only=True) as file:
        headers = [dict(part.header) for part in file.parts]  # closing the file empties its own
        parts = [_part(header, path, len(headers), k) for k, header in enumerate(headers)]
        check_count((sum(part.count for part in parts),), path)
    return parts


def exr_pixels(path: Path, parts: Sequence[ExrPart]) -> Iterator[NDArray[Any]]:
    """Yield the colour of each part in turn, (rows, columns, 1 or 3) of float16, float32 or uint32.

    OpenEXR decodes all parts at once.
    """
    import OpenEXR

    with decoding(path, "EXR"), OpenEXR.File(str(path), separate_channels=True) as file:
        pixels = {
            _name(part.header): {c: part.channels[c].pixels for c in part.channels}
            for part in file.parts
        }
    for k, part in enumerate(parts):
        if part.name not in pixels:  # how OpenEXR reports pixels it could not read
            place = _place(path, len(parts), k)
            raise PhotographError(f"{place}: truncated or damaged EXR; save or copy it again")
        channels = pixels.pop(part.name)
        yield np.stack([channels[c] for c in part.colour], axis=-1)


def _part(header: Mapping[str, Any], path: Path, count: int, k: int) -> ExrPart:
    """Check the header of a part."""
    place = _place(path, count, k)
    if header["type"].name not in _FLAT:
        raise PhotographError(f"{place}: is a deep image; save it flattened")
    names = [channel.name for channel in header["channels"]]
    (left, top), (right, bottom) = (corner.tolist() for corner in header["dataWindow"])
    size = (bottom - top + 1, right - left + 1)
    check_count((*size, len(names)), path)
    if "tiles" in header:
        check_count((header["tiles"].ySize, header["tiles"].xSize, len(names)), path)
    colour = _colour_channels(names, place)
    if any((c.xSampling, c.ySampling) != (1, 1) for c in header["channels"]):
        raise PhotographError(f"{place}: has subsampled channels; save it as full RGB")
    left_out = tuple(name for name in names if name not in colour)
    return ExrPart(_name(header), size, tuple(colour), left_out, _metadata(header))


def _place(path: Path, count: int, k: int) -> Path:
    """Return what to call a part in messages: a lone one is the file."""
    return path if count == 1 else place_of(path, k)


def _name(header: Mapping[str, Any]) -> str:
    return str(header.get("name", ""))


def _colour_channels(names: Sequence[str], place: Path) -> list[str]:
    """Return the names of the red, green and blue channels, or of the grey one."""
    opaque = [name for name in names if name.rpartition(".")[2] != "A"]
    prefixes = [name[:-1] for name in opaque if name.rpartition(".")[2] == "R"]
    layers = [prefix for prefix in prefixes if {f"{prefix}G", f"{prefix}B"} <= set(opaque)]
    if "" in layers or len(layers) == 1:
        layer = "" if "" in layers else layers[0]
        return [f"{layer}{colour}" for colour in "RGB"]
    if len(opaque) == 1:
        return opaque
    raise PhotographError(
        f"{place}: among its channels {listed(names) or 'none'} there is not exactly one "
        "colour image; save R, G, B alone"
    )


def _metadata(header: Mapping[str, Any]) -> dict[str, str | float]:
    """Return text and numbers of a header, doubles unpacked from the arrays they come in."""
    found: dict[str, str | float] = {}
    for name, value in header.items():
        if name in _STRUCTURAL:
            continue
        if isinstance(value, str | float | int):
            found[name] = value
        elif isinstance(value, np.ndarray) and value.shape == (1,):
            found[name] = float(value[0])
    return found
