"""NumPy files, read without ever loading a pickle."""

from __future__ import annotations

import zipfile
from pathlib import Path
from typing import IO, Any

import numpy as np
import numpy.lib.format as npy
from numpy.typing import NDArray

from periscopy_sim.errors import PhotographError
from periscopy_sim.storage.decoding import check_count, decoding

_NOT_REAL = {
    "b": "truth values",
    "c": "complex numbers",
    "O": "Python objects, which are never loaded",
    "S": "text",
    "U": "text",
    "V": "records",
    "M": "dates",
    "m": "times",
}


def check_real(dtype: np.dtype[Any], name: str) -> None:
    """Refuse a dtype whose values are not integers or floating-point numbers.

    Raises
    ------
    PhotographError
        Naming what the array `name` holds instead.
    """
    if dtype.kind not in "iuf":
        held = _NOT_REAL.get(dtype.kind, "no numbers")
        raise PhotographError(f"{name}: holds {held} ({dtype}); save real numbers, as float32 say")


def read_npy(path: Path) -> NDArray[Any]:
    """Read an NPY file of real numbers, of any shape, endianness and memory order.

    Raises
    ------
    PhotographError
        If the file is damaged, holds anything but real numbers, or announces too many.
    """
    with decoding(path, "NPY"), path.open("rb") as stream:
        return _read_array(stream, path)


def read_npz(path: Path, key: str) -> NDArray[Any]:
    """Read one array of real numbers from an NPZ archive.

    Raises
    ------
    PhotographError
        As `read_npy`, and if the archive has no array `key`: the message lists those it has.
    """
    with decoding(path, "NPZ"), zipfile.ZipFile(path) as archive:
        keys = [name.removesuffix(".npy") for name in archive.namelist()]
        if key not in keys:
            raise PhotographError(
                f"{path}: has no array '{key}', only {', '.join(keys) or 'none at all'}; "
                f"save it with numpy.savez(..., {key}=...)"
            )
        with archive.open(f"{key}.npy") as stream:  # compares the checksum
            return _read_array(stream, path)


def _read_array(stream: IO[bytes], path: Path) -> NDArray[Any]:
    """Check what the header announces, then read the values."""
    first_version = npy.read_magic(stream) == (1, 0)
    read_header = npy.read_array_header_1_0 if first_version else npy.read_array_header_2_0
    shape, _, dtype = read_header(stream)
    check_real(dtype, str(path))
    check_count(shape, path)
    stream.seek(0)
    return np.asarray(npy.read_array(stream, allow_pickle=False))
