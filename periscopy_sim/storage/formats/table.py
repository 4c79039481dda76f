"""The file formats: how each is known, which decoder reads it, and how its frames are opened.

A new format is one decoder and one row of `FORMATS`; photographs, masks, hidden images, frames and
folders of pictures all read it then.
"""

import re
from collections.abc import Callable, Iterable
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from numpy.typing import NDArray

from periscopy_sim.errors import PhotographError, path_fault
from periscopy_sim.storage.formats import arrays, rasters
from periscopy_sim.storage.formats.decoding import Picture, Size
from periscopy_sim.storage.formats.exr import decode_exr


@dataclass(frozen=True)
class FileFormat:
    """A row of the table.

    `decode` reads one picture from a path, for a purpose: `photograph`, `hidden` or `mask`, which
    is the key of its array if a file holds several; another size than is given, or one that no
    memory holds, is an error before it is decoded. `open_stack` opens the frames of one file;
    None for formats that hold one.
    """

    name: str
    suffixes: tuple[str, ...]  # in lower case; they count only where a folder is listed
    signature: bytes  # regular expression of the first bytes
    decode: Callable[[Path, str, Size], Picture]
    open_stack: Callable[[Path, Size], NDArray[Any]] | None = None
    is_raw: bool = False  # a sensor's counts, no mask and no hidden image; the suffix counts, too


FORMATS = (
    FileFormat("camera raw", rasters.RAW_SUFFIXES, rasters.RAW_SIGNATURE, rasters.read_camera_raw,
               is_raw=True),
    FileFormat("EXR", (".exr",), rb"\x76\x2f\x31\x01", decode_exr),
    FileFormat("NPY", (".npy",), rb"\x93NUMPY", arrays.read_npy, arrays.mapped_stack),
    FileFormat("NPZ", (".npz",), rb"PK(\x03\x04|\x05\x06)",  # or no entry
               arrays.read_npz, arrays.npz_array),
    FileFormat("PNG", (".png",), rb"\x89PNG\r\n\x1a\n", rasters.read_png),
    FileFormat("TIFF", (".tif", ".tiff"), rb"II[*+]\x00|MM\x00[*+]",  # and BigTIFF
               rasters.read_tiff),
    FileFormat("JPEG", (".jpg", ".jpeg"), rb"\xff\xd8\xff", rasters.read_8_bits),
)  # fmt: skip


def format_of(path: Path) -> FileFormat:
    """Return the format of a file by its first bytes, whatever its suffix."""
    if path.exists() and not path.is_file():  # a pipe can be read but once
        raise PhotographError(f"{path}: is a folder or no regular file; name a file")
    try:
        with path.open("rb") as stream:
            head = stream.read(32)  # twice the longest signature
    except OSError as error:
        fault = path_fault(path) or f"{error.strerror}; check the path"
        raise PhotographError(f"{path}: {fault}") from error
    for row in FORMATS:
        is_named = path.suffix.lower() in row.suffixes
        if re.match(row.signature, head, re.DOTALL) and (is_named or not row.is_raw):
            return row
    names = ", ".join(row.name for row in FORMATS)
    raise PhotographError(f"{path}: is damaged, or of no known format ({names})")


def decode_picture(path: Path, key: str, size: Size = None) -> Picture:
    """Return a picture other than a photograph: a `mask` or a `hidden` image."""
    row = format_of(path)
    if row.is_raw:
        known = ", ".join(each.name for each in FORMATS if not each.is_raw)
        raise PhotographError(f"{path}: is {row.name}; give a picture ({known})")
    return row.decode(path, key, size)


def libraries_of(files: Iterable[Path]) -> list[str]:
    """Return the library of an extra that camera raw files, if there are any, need."""
    return ["rawpy"] if any(file.suffix.lower() in rasters.RAW_SUFFIXES for file in files) else []


def suffixes(raw: bool = True) -> dict[str, str]:
    """Return the names of formats by suffix, with or without those of sensors' counts."""
    return {suffix: row.name for row in FORMATS for suffix in row.suffixes if raw or not row.is_raw}
