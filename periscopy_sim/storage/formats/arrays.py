"""NumPy files, read without ever loading a pickle."""

from __future__ import annotations

import io
import zipfile
from pathlib import Path
from typing import IO, Any

import numpy as np
import numpy.lib.format as npy
from numpy.typing import NDArray

from periscopy_sim.errors import PhotographError
from periscopy_sim.photograph import check_real
from periscopy_sim.storage.formats.decoding import check_count, decoding, listed

_LONGEST_HEADER = 10_000  # bytes: NumPy's own limit, which it looks at once it has read them


def read_npy(path: Path, *, truth_values: bool = False) -> NDArray[Any]:
    """Read an NPY file of real numbers, of any shape, endianness and memory order.

    `truth_values` are read only if asked for.
    """
    with decoding(path, "NPY"), path.open("rb") as stream:
        return _read_array(stream, path, truth_values)


def read_npz(path: Path, key: str, *, truth_values: bool = False) -> NDArray[Any]:
    """Read one array of an NPZ archive by its key, as `read_npy` does."""
    with decoding(path, "NPZ"), zipfile.ZipFile(path) as archive:
        check_key(archive, key, path)
        with archive.open(f"{key}.npy") as stream:  # compares the checksum
            return _read_array(stream, path, truth_values)


def check_key(archive: zipfile.ZipFile, key: str, path: Path) -> None:
    """Refuse an NPZ archive that has no array of a name."""
    keys = [name.removesuffix(".npy") for name in archive.namelist()]
    if key not in keys:
        raise PhotographError(
            f"{path}: has no array '{key}', only {listed(keys) or 'none at all'}; "
            f"save it with numpy.savez(..., {key}=...)"
        )


def read_header(stream: IO[bytes]) -> tuple[tuple[int, ...], bool, np.dtype[Any]]:
    """Return shape, Fortran order and dtype from the header at the start of an NPY stream.

    No more is read than a header can need; one that is damaged or longer is a ValueError.
    """
    first_version = npy.read_magic(stream) == (1, 0)
    length = stream.read(2 if first_version else 4)
    if int.from_bytes(length, "little") > _LONGEST_HEADER:
        raise ValueError(f"its header announces {int.from_bytes(length, 'little')} bytes of itself")
    head = io.BytesIO(length + stream.read(int.from_bytes(length, "little")))
    return npy.read_array_header_1_0(head) if first_version else npy.read_array_header_2_0(head)


def _read_array(stream: IO[bytes], path: Path, truth_values: bool) -> NDArray[Any]:
    """Check what the header announces, then read the values."""
    shape, _, dtype = read_header(stream)
    if not (truth_values and dtype.kind == "b"):
        check_real(dtype, str(path))
    check_count(shape, path)
    stream.seek(0)
    return np.asarray(npy.read_array(stream, allow_pickle=False))
