"""OpenEXR images with metadata."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from periscopy_sim.errors import PhotographError
from periscopy_sim.storage.formats.decoding import check_count, decoding
from periscopy_sim.storage.outputs.staging import staged_file

_STRUCTURAL = frozenset(  # attributes that describe the pixels, which metadata must not replace
    {
        "channels",
        "chunkCount",
        "compression",
        "dataWindow",
        "deepImageState",
        "displayWindow",
        "lineOrder",
        "maxSamplesPerPixel",
        "name",
        "pixelAspectRatio",
        "screenWindowCenter",
        "screenWindowWidth",
        "tiles",
        "type",
        "version",
        "view",
    }
)
_LONGEST_NAME = 255  # characters, "long names" in the OpenEXR file layout
_FLAT = ("scanlineimage", "tiledimage")


@dataclass(frozen=True, eq=False)
class ExrImage:
    """What an OpenEXR file holds.

    Attributes
    ----------
    colour : (rows, columns, 1 or 3) float16, float32 or uint32
        Linear light: red, green, blue, or grey alone.
    left_out : tuple of str
        The other channels of the file, alpha among them.
    metadata : dict
        Its attributes that are text or numbers and do not describe the pixels.
    """

    colour: NDArray[Any]
    left_out: tuple[str, ...]
    metadata: dict[str, str | float]


def write_exr(path: Path, image: ArrayLike, metadata: Mapping[str, str | float]) -> None:
    """Write a float32 RGB image; the same inputs give the same bytes.

    Parameters
    ----------
    path : Path
        Appears once complete.
    image : (rows, columns, 3)
        Linear light.
    metadata : mapping
        Attributes of the file: text, and numbers at double precision.

    Raises
    ------
    ValueError
        If the image has another shape, or a name is empty, over 255 characters long, or one that
        OpenEXR itself uses, such as `compression`.
    OutputError
        If the path cannot be written.
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
        **{name: _attribute(value) for name, value in metadata.items()},
    }
    # OpenEXR ignores strides: each channel must be contiguous.
    channels = {c: np.ascontiguousarray(pixels[..., i]) for i, c in enumerate("RGB")}
    with staged_file(path) as staged, OpenEXR.File(header, channels) as file:
        file.write(str(staged))


def read_exr(path: Path) -> tuple[NDArray[np.float32], dict[str, str | float]]:
    """Read an image written by `write_exr`, or the colour of any flat OpenEXR file.

    Returns
    -------
    image : (rows, columns, 3) float32
        Linear light; a lone grey channel is replicated.
    metadata : dict
        As `ExrImage.metadata`.

    Raises
    ------
    PhotographError
        As `decode_exr`.
    """
    decoded = decode_exr(path)
    rows, columns, _ = decoded.colour.shape
    image = np.broadcast_to(decoded.colour, (rows, columns, 3)).astype(np.float32)
    return image, decoded.metadata


def decode_exr(path: Path) -> ExrImage:
    """Read the colour channels of an OpenEXR file of one flat part, and what goes with them.

    Channels R, G, B are taken, in whatever layer they are, else a lone Y or the only channel.

    Raises
    ------
    PhotographError
        If the file is damaged, deep, subsampled or of several parts, or its colour is ambiguous.
    """
    import OpenEXR

    with decoding(path, "EXR"):
        with OpenEXR.File(str(path), header_only=True) as file:
            if len(file.parts) != 1:
                raise PhotographError(f"{path}: has {len(file.parts)} parts; save one image alone")
            header = dict(file.header())  # closing the file empties its own
        if header["type"].name not in _FLAT:
            raise PhotographError(f"{path}: is a deep image; save it flattened")
        names = [channel.name for channel in header["channels"]]
        (left, top), (right, bottom) = (corner.tolist() for corner in header["dataWindow"])
        check_count((bottom - top + 1, right - left + 1, len(names)), path)
        if "tiles" in header:
            check_count((header["tiles"].ySize, header["tiles"].xSize, len(names)), path)
        chosen = _colour_channels(names, path)
        if any((c.xSampling, c.ySampling) != (1, 1) for c in header["channels"]):
            raise PhotographError(f"{path}: has subsampled channels; save it as full RGB")
        with OpenEXR.File(str(path), separate_channels=True) as file:
            if not file.parts:  # how OpenEXR reports pixels it could not read
                raise PhotographError(f"{path}: truncated or damaged EXR; save or copy it again")
            channels = file.channels()
            colour = np.stack([channels[name].pixels for name in chosen], axis=-1)
    left_out = tuple(name for name in names if name not in chosen)
    return ExrImage(colour, left_out, _metadata(header))


def _colour_channels(names: Sequence[str], path: Path) -> list[str]:
    """Names of the red, green and blue channels, or of the grey one."""
    opaque = [name for name in names if name.rpartition(".")[2] != "A"]
    prefixes = [name[:-1] for name in opaque if name.rpartition(".")[2] == "R"]
    layers = [prefix for prefix in prefixes if {f"{prefix}G", f"{prefix}B"} <= set(opaque)]
    if "" in layers or len(layers) == 1:
        layer = "" if "" in layers else layers[0]
        return [f"{layer}{colour}" for colour in "RGB"]
    if len(opaque) == 1:
        return opaque
    raise PhotographError(
        f"{path}: among its channels {', '.join(names) or 'none'} there is not exactly one "
        "colour image; save R, G, B alone"
    )


def _attribute(value: str | float) -> str | NDArray[np.float64]:
    """Value as OpenEXR takes it: Python floats become single precision, arrays stay double."""
    return value if isinstance(value, str) else np.array([value], dtype=np.float64)


def _metadata(header: Mapping[str, Any]) -> dict[str, str | float]:
    """Text and numbers of a header, doubles unpacked from the arrays they come in."""
    found: dict[str, str | float] = {}
    for name, value in header.items():
        if name in _STRUCTURAL:
            continue
        if isinstance(value, str | float | int):
            found[name] = value
        elif isinstance(value, np.ndarray) and value.shape == (1,):
            found[name] = float(value[0])
    return found
