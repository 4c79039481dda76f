"""Frames in one file or archive: NPY, NPZ, the parts of an OpenEXR file, Zarr."""

from __future__ import annotations

import math
import zipfile
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from pathlib import Path
from typing import Any, TypeAlias

import numpy as np
import numpy.lib.format as npy
from numpy.typing import ArrayLike, NDArray

from periscopy_sim.errors import PhotographError
from periscopy_sim.photograph import check_real, check_size
from periscopy_sim.storage.formats.arrays import check_key, read_header
from periscopy_sim.storage.formats.decoding import check_count, decoding, listed, place_of
from periscopy_sim.storage.formats.exr import exr_parts, exr_pixels
from periscopy_sim.storage.sequences.frames import Frames

Stack: TypeAlias = Frames[NDArray[Any]]
"""Frames that one file or archive holds, not yet checked one by one."""

KEY = "photograph"
"""Name of the array in an NPZ file or a Zarr group."""

_ZARR_HEADS = ("zarr.json", ".zarray", ".zattrs", ".zgroup", ".zmetadata")
_OVERHEAD = 1 << 16  # bytes that any chunk may have beside its values

MOST_FRAMES = 10**6
"""Frames of a sequence: nine hours at 30 a second. A header may announce any number."""


@contextmanager
def npy_writer(
    path: Path, shape: Sequence[int], dtype: type[np.floating[Any]]
) -> Iterator[Callable[[ArrayLike], object]]:
    """Write an NPY file of a stack, (frames, ...), as `numpy.save` would.

    The function yielded takes each frame in turn.
    """
    described = npy.dtype_to_descr(np.dtype(dtype))
    header = {"descr": described, "fortran_order": False, "shape": tuple(shape)}
    with path.open("wb") as stream:
        npy.write_array_header_1_0(stream, header)
        yield lambda frame: stream.write(np.ascontiguousarray(frame, dtype=dtype).tobytes())


def mapped_stack(path: Path) -> NDArray[Any]:
    """Return an NPY file of any shape as a memory map, read as it is used."""
    with decoding(path, "NPY"):
        array: NDArray[Any] = np.load(path, mmap_mode="r", allow_pickle=False)
        return array


def npy_stack(path: Path, shape: tuple[int, int]) -> Stack:
    """Open an NPY file (frames, rows, columns, 3); see `open_frames`."""
    stack = mapped_stack(path)
    _check_stack(stack.shape, stack.dtype, shape, path)
    return Frames(_numbers(len(stack)), (), lambda: iter(stack))


def npz_stack(path: Path, shape: tuple[int, int]) -> Stack:
    """Open an NPZ file's array `photograph`, decompressed frame by frame; see `open_frames`."""
    with decoding(path, "NPZ"), zipfile.ZipFile(path) as archive:
        check_key(archive, KEY, path)
        with archive.open(f"{KEY}.npy") as stream:
            stack, fortran, dtype = read_header(stream)
            held = archive.getinfo(f"{KEY}.npy").file_size - stream.tell()
    _check_stack(stack, dtype, shape, path)
    if fortran:
        raise PhotographError(f"{path}: is in Fortran order; save numpy.ascontiguousarray of it")
    size = math.prod(stack[1:]) * dtype.itemsize
    if held != stack[0] * size:
        raise PhotographError(f"{path}: '{KEY}' is cut short or damaged; save or copy it again")

    def values() -> Iterator[NDArray[Any]]:
        with zipfile.ZipFile(path) as archive, archive.open(f"{KEY}.npy") as stream:
            read_header(stream)
            for k in range(stack[0]):
                with decoding(place_of(path, k), "NPZ"):  # at the end it compares the checksum
                    content = stream.read(size if k < stack[0] - 1 else size + 1)
                    frame = np.frombuffer(content, dtype).reshape(stack[1:])
                yield frame

    return Frames(_numbers(stack[0]), (), values)


def exr_stack(path: Path, shape: tuple[int, int]) -> Stack:
    """Open an EXR file, one frame a part; see `open_frames`."""
    parts = exr_parts(path)
    if not parts:
        raise PhotographError(f"{path}: holds no frames; give one at least")
    for k, part in enumerate(parts):
        check_size(part.size, shape, str(place_of(path, k)))
    left_out = sorted({name for part in parts for name in part.left_out})
    warnings = (f"{path}: left out the channels {listed(left_out)}",) if left_out else ()
    return Frames(tuple(part.name for part in parts), warnings, lambda: exr_pixels(path, parts))


def zarr_stack(path: Path, shape: tuple[int, int]) -> Stack:
    """Open a Zarr array, or a group's array `photograph`, chunk by chunk; see `open_frames`."""
    import zarr

    with decoding(path, "Zarr"):
        array = zarr.open(path, mode="r")
        if isinstance(array, zarr.Group):
            if KEY not in array:
                keys = listed(sorted(array.keys())) or "none at all"
                raise PhotographError(f"{path}: has no array '{KEY}', only {keys}; name one so")
            array = array[KEY]
        if not isinstance(array, zarr.Array):
            raise PhotographError(f"{path}: '{KEY}' is a group; give an array of that name")
        codecs = (*(array.filters or ()), *(array.compressors or ()))
        if any(getattr(codec, "codec_id", "") == "pickle" for codec in codecs):
            raise PhotographError(f"{path}: holds Python objects, which are never loaded")
        packed = sorted({"scale_factor", "add_offset"} & set(array.attrs))
        chunks, stored = array.chunks, array.shards or array.chunks
    _check_stack(array.shape, array.dtype, shape, path)
    if packed:
        raise PhotographError(f"{path}: is packed by {packed[0]}; save it as float32")
    check_count(stored, path)
    with decoding(path, "Zarr"):
        most = 2 * math.prod(stored) * array.dtype.itemsize + _OVERHEAD
        names = [type(codec).__name__.removesuffix("Codec") for codec in codecs]
        behind = names[names.index("Blosc") + 1 :] if "Blosc" in names else None
        if behind is not None and (array.shards or behind not in ([], ["Crc32c"])):
            raise PhotographError(
                f"{path}: is packed by Blosc within shards or other codecs; save it with zstd"
            )
        _check_stored(path / array.path, most, None if behind is None else 4 * len(behind), path)
        absent = array.nchunks - array.nchunks_initialized
    missing = (
        f"{path}: {absent} of {array.nchunks} chunks are not there and read as {array.fill_value}; "
        "unless that was written, copy it again"
    )

    def values() -> Iterator[NDArray[Any]]:
        for start in range(0, array.shape[0], chunks[0]):  # a chunk cannot be read in part
            stop = min(start + chunks[0], array.shape[0])
            with decoding(place_of(path, start if stop == start + 1 else f"{start} ff."), "Zarr"):
                block = np.asarray(array[start:stop])
            yield from block

    return Frames(_numbers(array.shape[0]), (missing,) if absent else (), values)


def _numbers(count: int) -> tuple[str, ...]:
    return tuple(map(str, range(count)))


def _check_stored(folder: Path, most: int, behind: int | None, path: Path) -> None:
    """Refuse chunks that are stored in, or announce, more bytes than they can need.

    Blosc's own decoder would follow a wrong length past the end of the chunk, and crash; behind
    what it wrote there are so many bytes, None where it wrote nothing.
    """
    for file in folder.rglob("*"):
        if file.name in _ZARR_HEADS or not file.is_file():
            continue
        size = file.stat().st_size
        if size > most:
            raise PhotographError(f"{path}: the chunk '{file.name}' is larger than what it holds")
        if behind is not None:
            with file.open("rb") as stream:
                head = stream.read(16)
            unpacked, packed = (int.from_bytes(head[k : k + 4], "little") for k in (4, 12))
            if unpacked > most or packed + behind != size:
                raise PhotographError(f"{path}: the chunk '{file.name}' is damaged; copy it again")


def _check_stack(
    shape: Sequence[int], dtype: np.dtype[Any], camera: tuple[int, int], path: Path
) -> None:
    """Check what a header tells of a stack of photographs."""
    check_real(dtype, str(path))
    if len(shape) != 4 or shape[3] not in (1, 3):
        raise PhotographError(
            f"{path}: has shape {tuple(shape)}; give a stack (frames, rows, columns, 3)"
        )
    if shape[0] == 0:
        raise PhotographError(f"{path}: holds no frames; give one at least")
    if not 1 <= shape[0] <= MOST_FRAMES:
        raise PhotographError(f"{path}: holds {shape[0]} frames; give {MOST_FRAMES} at most")
    check_size(tuple(shape[1:3]), camera, str(path))
