"""OpenEXR images with metadata."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from periscopy_sim.errors import PhotographError
from periscopy_sim.storage.formats.decoding import Picture, decoding, listed
from periscopy_sim.storage.outputs.staging import staged_file

_STRUCTURAL = {  # attributes that describe the pixels, which metadata must not replace
    *("channels", "chunkCount", "compression", "dataWindow", "deepImageState", "displayWindow"),
    *("lineOrder", "maxSamplesPerPixel", "name", "pixelAspectRatio", "screenWindowCenter"),
    *("screenWindowWidth", "tiles", "type", "version", "view"),
}
_FLAT = ("scanlineimage", "tiledimage")


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
    picture, metadata = _read(path)
    shape = (*picture.values.shape[:2], 3)
    return np.broadcast_to(picture.values, shape).astype(np.float32), metadata


def decode_exr(path: Path, *_: object) -> Picture:
    """Read the colour channels of an OpenEXR file of one flat part, or its grey one."""
    return _read(path)[0]


def _read(path: Path) -> tuple[Picture, dict[str, str | float]]:
    """Return R, G, B in whatever layer they are, else a lone Y or the only channel, and metadata.

    The metadata are texts and numbers.
    """
    import OpenEXR

    with decoding(path, "EXR"):
        with OpenEXR.File(str(path), header_only=True) as file:
            count = len(file.parts)
        with OpenEXR.File(str(path), separate_channels=True) as file:
            if not count or len(file.parts) < count:  # how OpenEXR reports pixels it cannot read
                raise PhotographError(f"{path}: truncated or damaged EXR; save or copy it again")
            part, header = file.parts[0], file.parts[0].header
            if count > 1 or header["type"].name not in _FLAT:
                raise PhotographError(f"{path}: has several parts or is deep; save one flat image")
            colour = _colour_channels(list(part.channels), path)
            pixels = np.stack([part.channels[name].pixels for name in colour], axis=-1)
            left_out = tuple(name for name in part.channels if name not in colour)
            return Picture(pixels, left_out=left_out), _metadata(header)


def _colour_channels(names: Sequence[str], path: Path) -> list[str]:
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
        f"{path}: among its channels {listed(names) or 'none'} there is not exactly one "
        "colour image; save R, G, B alone"
    )


def _metadata(header: Mapping[str, Any]) -> dict[str, str | float]:
    """Return text and numbers of a header, doubles unpacked from the arrays they come in."""
    held = {name: value for name, value in header.items() if name not in _STRUCTURAL}
    lone = {n: float(v[0]) for n, v in held.items() if isinstance(v, np.ndarray) and v.size == 1}
    return {name: v for name, v in held.items() if isinstance(v, str | float | int)} | lone
