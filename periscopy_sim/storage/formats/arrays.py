"""Arrays in NPY and NPZ files and in Zarr archives; pickles are never loaded."""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path
from typing import Any, TypeAlias

import numpy as np
from numpy.typing import NDArray

from periscopy_sim.errors import PhotographError
from periscopy_sim.photograph import check_real
from periscopy_sim.storage.formats.decoding import (
    Frames,
    Picture,
    check_stack,
    decoding,
    listed,
    place_of,
)

Stack: TypeAlias = Frames[NDArray[Any]]
"""Frames that one file or archive holds, not yet checked one by one."""

KEY = "photograph"
"""Name of a stack in an NPZ file or a Zarr group."""


def read_npy(path: Path, key: str) -> Picture:
    """Read an NPY file of real numbers, and of truth values where `key` is `mask`."""
    with decoding(path, "NPY"):
        values = np.load(path, allow_pickle=False)
    return Picture(_checked(values, key, path))


def read_npz(path: Path, key: str) -> Picture:
    """Read the array `key` of an NPZ archive as `read_npy` does.

    8-bit integers of `hidden` are what a monitor was sent, made for screens.
    """
    values = _checked(_member(path, key), key, path)
    return Picture(values, is_display=key == "hidden" and values.dtype == np.uint8)


def mapped_stack(path: Path) -> NDArray[Any]:
    """Return an NPY file of any shape as a memory map, read as it is used."""
    with decoding(path, "NPY"):
        return np.asanyarray(np.load(path, mmap_mode="r", allow_pickle=False))


def npy_stack(path: Path, shape: tuple[int, int]) -> Stack:
    """Open an NPY file (frames, rows, columns, 3); see `open_frames`."""
    return _frames(mapped_stack(path), shape, path)


def npz_stack(path: Path, shape: tuple[int, int]) -> Stack:
    """Open an NPZ file's array `photograph`, which is read into memory; see `open_frames`."""
    return _frames(_member(path, KEY), shape, path)


def zarr_stack(path: Path, shape: tuple[int, int]) -> Stack:
    """Open a Zarr array, or a group's array `photograph`, chunk by chunk; see `open_frames`."""
    import zarr

    with decoding(path, "Zarr"):
        array = zarr.open(path, mode="r")
        if isinstance(array, zarr.Group):
            held, array = array, array.get(KEY)
            if not isinstance(array, zarr.Array):
                keys = listed(sorted(held.array_keys())) or "none at all"
                raise PhotographError(f"{path}: has no array '{KEY}', only {keys}; name one so")
        if any(getattr(codec, "codec_id", "") == "pickle" for codec in array.filters or ()):
            raise PhotographError(f"{path}: holds Python objects, which are never loaded")
        if packed := sorted({"scale_factor", "add_offset"} & set(array.attrs)):
            raise PhotographError(f"{path}: is packed by {packed[0]}; save it as float32")
        check_stack(array.shape, array.dtype, shape, path)
        absent = array.nchunks - array.nchunks_initialized
    missing = (
        f"{path}: {absent} of {array.nchunks} chunks are not there and read as {array.fill_value}; "
        "unless that was written, copy it again"
    )

    def values() -> Iterator[NDArray[Any]]:
        frames = array.chunks[0]  # a chunk cannot be read in part
        for start in range(0, array.shape[0], frames):
            with decoding(place_of(path, start if frames == 1 else f"{start} ff."), "Zarr"):
                block = np.asarray(array[start : start + frames])
            yield from block

    return Frames(_numbers(array.shape[0]), (missing,) if absent else (), values)


def _member(path: Path, key: str) -> NDArray[Any]:
    """Return the array of an NPZ archive by its key."""
    # Of its own file, NumPy leaves a damaged one open.
    with decoding(path, "NPZ"), path.open("rb") as file, np.load(file) as archive:
        if key not in archive:
            raise PhotographError(
                f"{path}: has no array '{key}', only {listed(archive.files) or 'none at all'}; "
                f"save it with numpy.savez(..., {key}=...)"
            )
        return np.asarray(archive[key])


def _checked(values: NDArray[Any], key: str, path: Path) -> NDArray[Any]:
    if not (key == "mask" and values.dtype.kind == "b"):
        check_real(values.dtype, str(path))
    return values


def _frames(stack: NDArray[Any], shape: tuple[int, int], path: Path) -> Stack:
    check_stack(stack.shape, stack.dtype, shape, path)
    return Frames(_numbers(len(stack)), (), lambda: iter(stack))


def _numbers(count: int) -> tuple[str, ...]:
    return tuple(map(str, range(count)))
