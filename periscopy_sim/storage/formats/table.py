"""The file formats: how each is known, which decoder reads it, and how its frames are opened.

A new format is one decoder and one row of `FORMATS`; photographs, masks, hidden images, frames and
folders of pictures all read it then.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from numpy.typing import NDArray

from periscopy_sim.errors import PhotographError
from periscopy_sim.storage.formats.arrays import mapped_stack, npz_array, read_npy, read_npz
from periscopy_sim.storage.formats.camera_raw import RAW_SIGNATURES, RAW_SUFFIXES, read_camera_raw
from periscopy_sim.storage.formats.decoding import Picture
from periscopy_sim.storage.formats.exr import decode_exr
from periscopy_sim.storage.formats.matlab import read_matlab_counts
from periscopy_sim.storage.formats.rasters import read_8_bits, read_png, read_tiff


@dataclass(frozen=True)
class FileFormat:
    """A row of the table.

    `decode` reads one picture from a path, for a purpose: `photograph`, `hidden` or `mask`, which
    is the key of its array if a file holds several. `open_stack` opens the frames of one file;
    None for formats that hold one.
    """

    name: str
    suffixes: tuple[str, ...]  # in lower case; they count only where a folder is listed
    signatures: tuple[tuple[int, bytes], ...]  # bytes by which a file is known, after their offset
    decode: Callable[[Path, str], Picture]
    open_stack: Callable[[Path], NDArray[Any]] | None = None
    is_raw: bool = False  # counts of a sensor, which are no mask and no hidden image
    within: str = ""  # a format with the same signature; then the suffix decides


TIFF = ((0, b"II*\x00"), (0, b"MM\x00*"), (0, b"II+\x00"), (0, b"MM\x00+"))  # and BigTIFF
MATLAB = ((124, b"\x00\x01IM"), (124, b"\x01\x00MI"))

FORMATS = (
    FileFormat("EXR", (".exr",), ((0, b"\x76\x2f\x31\x01"),), decode_exr),
    FileFormat("NPY", (".npy",), ((0, b"\x93NUMPY"),), read_npy, mapped_stack),
    # The second begins an archive without entries.
    FileFormat("NPZ", (".npz",), ((0, b"PK\x03\x04"), (0, b"PK\x05\x06")), read_npz, npz_array),
    FileFormat("PNG", (".png",), ((0, b"\x89PNG\r\n\x1a\n"),), read_png),
    FileFormat("TIFF", (".tif", ".tiff"), TIFF, read_tiff),
    FileFormat("JPEG", (".jpg", ".jpeg"), ((0, b"\xff\xd8\xff"),), read_8_bits),
    FileFormat(
        "camera raw", RAW_SUFFIXES, RAW_SIGNATURES, read_camera_raw, is_raw=True, within="TIFF"
    ),
    FileFormat("MATLAB", (".mat",), MATLAB, read_matlab_counts, is_raw=True),
)

_HEAD = 128  # bytes that tell every format


def format_of(path: Path) -> FileFormat:
    """Return the format of a file by its first bytes, whatever its suffix."""
    if path.exists() and not path.is_file():  # a pipe can be read but once
        raise PhotographError(f"{path}: is a folder or no regular file; name a file")
    try:
        with path.open("rb") as stream:
            head = stream.read(_HEAD)
    except OSError as error:
        reason = "no such file" if isinstance(error, FileNotFoundError) else error.strerror
        raise PhotographError(f"{path}: {reason}; check the path") from error
    for row in FORMATS:
        if any(head[offset:].startswith(known) for offset, known in row.signatures):
            suffix = path.suffix.lower()
            special = (r for r in FORMATS if r.within == row.name and suffix in r.suffixes)
            return next(special, row)
    *others, last = (row.name for row in FORMATS)
    raise PhotographError(
        f"{path}: is no {', '.join(others)} or {last} (-v7) file, or is empty or damaged"
    )


def decode_picture(path: Path, key: str) -> Picture:
    """Return a picture other than a photograph: a `mask` or a `hidden` image."""
    row = format_of(path)
    if row.is_raw:
        known = ", ".join(each.name for each in FORMATS if not each.is_raw)
        raise PhotographError(f"{path}: is {row.name}; give a picture ({known})")
    return row.decode(path, key)


def suffixes(raw: bool = True) -> dict[str, str]:
    """Return the names of formats by suffix, with or without those of sensors' counts."""
    return {suffix: row.name for row in FORMATS for suffix in row.suffixes if raw or not row.is_raw}
