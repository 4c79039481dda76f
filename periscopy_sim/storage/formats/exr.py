"""OpenEXR images with metadata."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import ArrayLike, NDArray

from periscopy_sim.errors import PhotographError
from periscopy_sim.photograph import check_size
from periscopy_sim.storage.formats.decoding import Frames, Picture, decoding, listed, place_of
from periscopy_sim.storage.outputs.staging import staged_file

_STRUCTURAL = {  # attributes that describe the pixels, which metadata must not replace
    *("channels", "chunkCount", "compression", "dataWindow", "deepImageState", "displayWindow"),
    *("lineOrder", "maxSamplesPerPixel", "name", "pixelAspectRatio", "screenWindowCenter"),
    *("screenWindowWidth", "tiles", "type", "version", "view"),
}
_FLAT = ("scanlineimage", "tiledimage")


class _Part(NamedTuple):
    """A part of an OpenEXR file."""

    name: str  # empty if it has none
    colour: NDArray[Any]  # (rows, columns, 1 or 3) of float16, float32 or uint32
    left_out: tuple[str, ...]  # its other channels
    metadata: dict[str, str | float]  # attributes of text or numbers beside the structural ones


def write_exr(path: Path, image: ArrayLike, metadata: Mapping[str, str | float]) -> None:
    """Write a float32 RGB image, (rows, columns, 3) linear light.

    The same inputs give the same bytes. The metadata are text, and numbers at double precision.
    Another shape of the image is a ValueError, and so is a name that OpenEXR itself uses, such as
    `compression`.
    """
    import OpenEXR

    pixels = np.asarray(image, dtype=np.float32)
    if pixels.ndim != 3 or pixels.shape[2] != 3 or pixels.size == 0:
        raise ValueError(f"image: expected shape (rows, columns, 3), got {pixels.shape}")
    if reserved := sorted(_STRUCTURAL & set(metadata)):
        raise ValueError(f"metadata: '{reserved[0]}' cannot name an attribute")
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
    part = _only_part(path)
    shape = (*part.colour.shape[:2], 3)
    return np.broadcast_to(part.colour, shape).astype(np.float32), part.metadata


def decode_exr(path: Path, *_: object) -> Picture:
    """Read the colour channels of an OpenEXR file of one flat part, or its grey one."""
    part = _only_part(path)
    return Picture(part.colour, left_out=part.left_out)


def exr_stack(path: Path, shape: tuple[int, int]) -> Frames[NDArray[Any]]:
    """Open an EXR file, one frame a part, all of which OpenEXR decodes; see `open_frames`."""
    parts = _parts(path)
    for k, part in enumerate(parts):
        check_size(part.colour.shape[:2], shape, str(place_of(path, k)))
    left_out = sorted({name for part in parts for name in part.left_out})
    warnings = (f"{path}: left out the channels {listed(left_out)}",) if left_out else ()
    names = tuple(part.name for part in parts)
    return Frames(names, warnings, lambda: (part.colour for part in parts))


def _only_part(path: Path) -> _Part:
    parts = _parts(path)
    if len(parts) != 1:
        raise PhotographError(f"{path}: has {len(parts)} parts; save one image alone")
    return parts[0]


def _parts(path: Path) -> list[_Part]:
    """Read an OpenEXR file whole.

    Of each part the channels R, G, B are taken, in whatever layer they are, else a lone Y or the
    only channel.
    """
    import OpenEXR

    with decoding(path, "EXR"):
        with OpenEXR.File(str(path), header_only=True) as file:
            count = len(file.parts)
        with OpenEXR.File(str(path), separate_channels=True) as file:
            if not count or len(file.parts) < count:  # how OpenEXR reports pixels it cannot read
                raise PhotographError(f"{path}: truncated or damaged EXR; save or copy it again")
            places = [path] if count == 1 else [place_of(path, k) for k in range(count)]
            return [_part(*each) for each in zip(file.parts, places, strict=True)]


def _part(part: Any, place: Path) -> _Part:
    header = part.header
    if header["type"].name not in _FLAT:
        raise PhotographError(f"{place}: is a deep image; save it flattened")
    names = list(part.channels)
    colour = _colour_channels(names, place)
    pixels = np.stack([part.channels[name].pixels for name in colour], axis=-1)
    left_out = tuple(name for name in names if name not in colour)
    return _Part(str(header.get("name", "")), pixels, left_out, _metadata(header))


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
    held = {name: value for name, value in header.items() if name not in _STRUCTURAL}
    lone = {n: float(v[0]) for n, v in held.items() if isinstance(v, np.ndarray) and v.size == 1}
    return {name: v for name, v in held.items() if isinstance(v, str | float | int)} | lone
