"""OpenEXR files of one flat part, in linear light: RGB or a lone grey channel."""

from collections.abc import Mapping
from mmap import ACCESS_READ, mmap
from pathlib import Path

import numpy as np
from numpy.typing import ArrayLike, NDArray

from periscopy_sim.errors import PhotographError
from periscopy_sim.storage.formats.decoding import Picture, Size, check_head, decoding, listed
from periscopy_sim.storage.outputs.staging import staged_file

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
    picture, metadata = _read(path)
    shape = (*picture.values.shape[:2], 3)
    return np.broadcast_to(picture.values, shape).astype(np.float32), metadata


def decode_exr(path: Path, _: str = "", size: Size = None) -> Picture:
    """Read the colour channels of an OpenEXR file of one flat part, or its grey one."""
    return _read(path, size)[0]


def _is_cut(path: Path) -> bool:
    """Return whether a file of lines from above ends in its last chunk; OpenEXR prints of each."""
    with path.open("rb") as file, mmap(file.fileno(), 0, access=ACCESS_READ) as data:

        def number(start: int, size: int) -> int:
            return int.from_bytes(data[start : start + size], "little")

        at = 8  # behind the magic number and the version
        while data[at]:
            at = data.find(b"\0", data.find(b"\0", at) + 1) + 1  # behind its name and its type
            at += 4 + number(at, 4)
        last = number(number(at + 1, 8) - 8, 8)  # the table of places ends at the first one
        return last == 0 or last + 8 + number(last + 4, 4) > len(data)


def _read(path: Path, size: Size = None) -> tuple[Picture, dict[str, str | float]]:
    """Return R, G and B, else the only channel, and the texts and numbers of the header."""
    import OpenEXR

    with decoding(path, "EXR"):
        with OpenEXR.File(str(path), header_only=True) as file:
            count, head = len(file.parts), file.parts[0].header
            low, high = head["dataWindow"]
            columns, rows = (int(side) + 1 for side in np.subtract(high, low, dtype=np.int64))
            check_head((rows, columns, len(head["channels"])), size, path)
            is_plain = head["type"] == OpenEXR.scanlineimage and count == 1
            if is_plain and head["lineOrder"] == OpenEXR.INCREASING_Y and _is_cut(path):
                raise ValueError("it is cut short")
        with OpenEXR.File(str(path), separate_channels=True) as file:
            # Without parts, as OpenEXR reports pixels that it cannot read, this is an IndexError.
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
            return Picture(pixels, left_out=left_out), metadata
