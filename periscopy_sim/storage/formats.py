"""The file formats: how each is known, which decoder reads it, and how its frames are opened.

A new format is one decoder and one row of `FORMATS`; photographs, masks, hidden images, frames and
folders of pictures all read it then.

Arrays come from NPY and NPZ files and from Zarr archives; pickles are never loaded.
"""

import re
from collections.abc import Callable, Iterable
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from periscopy_sim.errors import PhotographError, path_fault
from periscopy_sim.numerics.validation import AXES, check_budget
from periscopy_sim.photograph import check_real
from periscopy_sim.storage import rasters

PHOTOGRAPH = "photograph"
"""Name of the photographs in an NPZ file or a Zarr group."""

_NAN = "AAAAAAAA+H8="  # as xarray writes it into the attributes of Zarr 3

_PACKED = {"scale_factor", "add_offset", "missing_value", "_Unsigned", "valid_range", "valid_min",
           "valid_max"}  # fmt: skip
"""Attributes by which values stand for others, or for none."""


def read_npy(path: Path, key: str) -> rasters.Picture:
    """Read an NPY file of real numbers, and of truth values where `key` is `mask`."""
    values = np.asarray(mapped_stack(path))
    check_budget(values.shape, path)
    return rasters.Picture(_checked(values, key, path))


def read_npz(path: Path, key: str) -> rasters.Picture:
    """Read the array `key` of an NPZ archive as `read_npy` does."""
    return rasters.Picture(_checked(npz_array(path, key), key, path))


def mapped_stack(path: Path) -> NDArray[Any]:
    """Return an NPY file of any shape as a memory map, read as it is used."""
    with rasters.decoding(path, "NPY"):
        return np.asanyarray(np.load(path, mmap_mode="r", allow_pickle=False))


def npz_array(path: Path, key: str = PHOTOGRAPH) -> NDArray[Any]:
    """Return the array `key` of an NPZ archive."""
    # NumPy leaves a damaged file that it opened itself open.
    with rasters.decoding(path, "NPZ"), path.open("rb") as file, np.load(file) as archive:
        if key not in archive:
            raise PhotographError(
                f"{path}: has {rasters.listed(archive.files)}, no array '{key}'; add it"
            )
        return np.asarray(archive[key])


def zarr_stack(path: Path) -> Any:
    """Open the array `photograph` of a Zarr group of format 3, which holds no pickles.

    Chunks larger than any picture, frames without chunks, values that stand for others, by a scale
    or a fill value, values that nobody wrote, and dimensions in another order are a
    `PhotographError`.
    """
    import zarr

    with rasters.decoding(path, "Zarr", f"save a Zarr 3 group with an array '{PHOTOGRAPH}'"):
        array = zarr.open_group(path, mode="r", zarr_format=3)[PHOTOGRAPH]
        if _PACKED & {*array.attrs} or array.attrs.get("_FillValue", _NAN) != _NAN:
            raise ValueError("xarray packed its values; use float32, and NaN for missing ones")
        names = array.metadata.dimension_names or ()
        if any(names) and names[1:] != AXES[: len(names) - 1]:
            raise ValueError(f"its dimensions are {names}, not (any, {', '.join(AXES)})")
        if len(array.shape) == 4:
            check_budget(array.shape[1:], path)
        check_budget(array.chunks, path)
        if not np.isnan(array.fill_value) and array.nchunks_initialized < array.nchunks:
            raise ValueError("chunks are missing; write all of them (write_empty_chunks)")
        return array


def _checked(values: NDArray[Any], key: str, path: Path) -> NDArray[Any]:
    if not (key == "mask" and values.dtype.kind == "b"):
        check_real(values.dtype, str(path))
    return values


@dataclass(frozen=True)
class FileFormat:
    """A row of the table.

    `decode` reads one picture from a path, for a purpose: `photograph`, `hidden` or `mask`, which
    is the key of its array if a file holds several; one that no memory holds is an error before it
    is decoded. `open_stack` opens the frames of one file; None for formats that hold one.
    """

    name: str
    suffixes: tuple[str, ...]  # in lower case; they count only where a folder is listed
    signature: bytes  # regular expression of the first bytes
    decode: Callable[[Path, str], rasters.Picture]
    open_stack: Callable[[Path], NDArray[Any]] | None = None
    is_raw: bool = False  # a sensor's counts, no mask and no hidden image; the suffix counts, too


FORMATS = (
    FileFormat("camera raw", rasters.RAW_SUFFIXES, rasters.RAW_SIGNATURE, rasters.read_camera_raw,
               is_raw=True),
    FileFormat("EXR", (".exr",), rb"\x76\x2f\x31\x01", rasters.decode_exr),
    FileFormat("NPY", (".npy",), rb"\x93NUMPY", read_npy, mapped_stack),
    FileFormat("NPZ", (".npz",), rb"PK(\x03\x04|\x05\x06)",  # or no entry
               read_npz, npz_array),
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


def decode_picture(path: Path, key: str) -> rasters.Picture:
    """Return a picture other than a photograph: a `mask` or a `hidden` image."""
    row = format_of(path)
    if row.is_raw:
        known = ", ".join(each.name for each in FORMATS if not each.is_raw)
        raise PhotographError(f"{path}: is {row.name}; give a picture ({known})")
    return row.decode(path, key)


def libraries_of(files: Iterable[Path]) -> list[str]:
    """Return the library of an extra that camera raw files, if there are any, need."""
    return ["rawpy"] if any(file.suffix.lower() in rasters.RAW_SUFFIXES for file in files) else []


def suffixes(raw: bool = True) -> dict[str, str]:
    """Return the names of formats by suffix, with or without those of sensors' counts."""
    return {suffix: row.name for row in FORMATS for suffix in row.suffixes if raw or not row.is_raw}
