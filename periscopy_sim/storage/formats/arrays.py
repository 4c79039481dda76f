"""Arrays in NPY and NPZ files and in Zarr archives; pickles are never loaded."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from periscopy_sim.errors import PhotographError
from periscopy_sim.photograph import check_real
from periscopy_sim.storage.formats.decoding import Picture, decoding, listed

PHOTOGRAPH = "photograph"
"""Name of the photographs in an NPZ file or a Zarr group."""

_NAN = "AAAAAAAA+H8="  # as xarray writes it into the attributes of Zarr 3


def read_npy(path: Path, key: str) -> Picture:
    """Read an NPY file of real numbers, and of truth values where `key` is `mask`."""
    return Picture(_checked(np.asarray(mapped_stack(path)), key, path))


def read_npz(path: Path, key: str) -> Picture:
    """Read the array `key` of an NPZ archive as `read_npy` does.

    8-bit integers of `hidden` are what a monitor was sent, made for screens.
    """
    values = _checked(npz_array(path, key), key, path)
    return Picture(values, is_display=key == "hidden" and values.dtype == np.uint8)


def mapped_stack(path: Path) -> NDArray[Any]:
    """Return an NPY file of any shape as a memory map, read as it is used."""
    with decoding(path, "NPY"):
        return np.asanyarray(np.load(path, mmap_mode="r", allow_pickle=False))


def npz_array(path: Path, key: str = PHOTOGRAPH) -> NDArray[Any]:
    """Return the array `key` of an NPZ archive."""
    # Of its own file, NumPy leaves a damaged one open.
    with decoding(path, "NPZ"), path.open("rb") as file, np.load(file) as archive:
        if key not in archive:
            raise PhotographError(
                f"{path}: has no array '{key}', only {listed(archive.files) or 'none at all'}; "
                f"save it with numpy.savez(..., {key}=...)"
            )
        return np.asarray(archive[key])


def zarr_stack(path: Path) -> tuple[Any, tuple[str, ...]]:
    """Open a Zarr array, or a group's array `photograph`; return warnings, too.

    An archive whose values stand for others, by a scale or a fill value, is a `PhotographError`.
    """
    import zarr

    with decoding(path, "Zarr"):
        array = zarr.open(path, mode="r")
        if isinstance(array, zarr.Group):
            keys = listed(sorted(array.array_keys())) or "none at all"
            array = array.get(PHOTOGRAPH)
            if not isinstance(array, zarr.Array):
                raise PhotographError(f"{path}: has no array '{PHOTOGRAPH}', only {keys}")
        if any(getattr(codec, "codec_id", "") == "pickle" for codec in array.filters or ()):
            raise PhotographError(f"{path}: holds Python objects, which are never loaded")
        marks = {"scale_factor", "add_offset", "missing_value"} & set(array.attrs)
        fill = array.fill_value if array.metadata.zarr_format == 2 else 0
        if marks or array.attrs.get("_FillValue", _NAN) != _NAN or (fill and fill == fill):
            raise PhotographError(
                f"{path}: some values stand for others ({', '.join(marks) or '_FillValue'}), as "
                "xarray packs them; save it as float32, with NaN for missing values"
            )
        absent = array.nchunks - array.nchunks_initialized
    missing = f"{path}: {absent} of {array.nchunks} chunks are missing, read as {array.fill_value}"
    return array, (missing,) if absent else ()


def _checked(values: NDArray[Any], key: str, path: Path) -> NDArray[Any]:
    if not (key == "mask" and values.dtype.kind == "b"):
        check_real(values.dtype, str(path))
    return values
