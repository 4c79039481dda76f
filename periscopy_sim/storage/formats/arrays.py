"""Arrays in NPY and NPZ files and in Zarr archives; pickles are never loaded."""

from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from periscopy_sim.errors import PhotographError
from periscopy_sim.numerics.limits import check_budget
from periscopy_sim.numerics.validation import AXES
from periscopy_sim.photograph import check_real
from periscopy_sim.storage.formats.decoding import Picture, Size, check_head, decoding, listed

PHOTOGRAPH = "photograph"
"""Name of the photographs in an NPZ file or a Zarr group."""

_NAN = "AAAAAAAA+H8="  # as xarray writes it into the attributes of Zarr 3

_PACKED = {"scale_factor", "add_offset", "missing_value", "_Unsigned", "valid_range", "valid_min",
           "valid_max"}  # fmt: skip
"""Attributes by which values stand for others, or for none."""


def read_npy(path: Path, key: str, size: Size = None) -> Picture:
    """Read an NPY file of real numbers, and of truth values where `key` is `mask`."""
    values = np.asarray(mapped_stack(path))
    check_head(values.shape, size, path)
    return Picture(_checked(values, key, path))


def read_npz(path: Path, key: str, size: Size = None) -> Picture:
    """Read the array `key` of an NPZ archive as `read_npy` does.

    8-bit integers of `hidden` are what a monitor was sent, made for screens.
    """
    values = _checked(npz_array(path, size, key), key, path)
    return Picture(values, is_display=key == "hidden" and values.dtype == np.uint8)


def mapped_stack(path: Path, _: Size = None) -> NDArray[Any]:
    """Return an NPY file of any shape as a memory map, read as it is used."""
    with decoding(path, "NPY"):
        return np.asanyarray(np.load(path, mmap_mode="r", allow_pickle=False))


def npz_array(path: Path, size: Size = None, key: str = PHOTOGRAPH) -> NDArray[Any]:
    """Return the array `key` of an NPZ archive: of one size, if given, or frames of it."""
    # NumPy leaves a damaged file that it opened itself open.
    with decoding(path, "NPZ"), path.open("rb") as file, np.load(file) as archive:
        if key not in archive:
            raise PhotographError(f"{path}: has {listed(archive.files)}, no array '{key}'; add it")
        with archive.zip.open(f"{key.removesuffix('.npy')}.npy") as member:
            version, _ = np.lib.format.read_magic(member)  # there is none for plain numbers after 2
            head = getattr(np.lib.format, f"read_array_header_{version}_0")(member)
        check_head(head[0], size, path)
        return np.asarray(archive[key])


def zarr_stack(path: Path, size: Size = None) -> Any:
    """Open the array `photograph` of a Zarr group of format 3, which holds no pickles.

    A picture of another size than is given, chunks larger than any picture, frames without chunks,
    values that stand for others, by a scale or a fill value, values that nobody wrote, and
    dimensions in another order are a `PhotographError`.
    """
    import zarr

    from periscopy_sim.storage.formats.zarr_codecs import bounded_codecs

    with decoding(path, "Zarr", f"save a Zarr 3 group with an array '{PHOTOGRAPH}'"):
        files = [each for each in path.rglob("*") if not each.is_dir()]
        if irregular := [each.name for each in files if not each.is_file()]:
            raise ValueError(f"'{irregular[0]}' is no regular file")
        with bounded_codecs():
            array = zarr.open_group(path, mode="r", zarr_format=3)[PHOTOGRAPH]
        if _PACKED & {*array.attrs} or array.attrs.get("_FillValue", _NAN) != _NAN:
            raise ValueError("xarray packed its values; use float32, and NaN for missing ones")
        names = array.metadata.dimension_names or ()
        if any(names) and names[1:] != AXES[: len(names) - 1]:
            raise ValueError(f"its dimensions are {names}, not (any, {', '.join(AXES)})")
        if len(array.shape) == 4:
            check_head(array.shape[1:], size, path)
        check_budget(array.chunks, path)
        frames = len(files) * (array.shards or array.chunks)[0]  # at most, before chunks are listed
        is_whole = array.shape[0] <= frames and (
            np.isnan(array.fill_value) or array.nchunks_initialized >= array.nchunks
        )
        if not is_whole:
            raise ValueError("chunks are missing; write all of them (write_empty_chunks)")
        return array


def _checked(values: NDArray[Any], key: str, path: Path) -> NDArray[Any]:
    if not (key == "mask" and values.dtype.kind == "b"):
        check_real(values.dtype, str(path))
    return values
