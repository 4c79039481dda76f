"""Sequences of photographs, and what the hidden scene showed meanwhile, decoded frame by frame."""

import re
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from itertools import repeat
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from periscopy_sim.errors import PhotographError
from periscopy_sim.numerics import Array
from periscopy_sim.photograph import Photograph, blackened, check_real, check_size
from periscopy_sim.storage.formats.arrays import mapped_stack, zarr_stack
from periscopy_sim.storage.formats.decoding import decoding, listed
from periscopy_sim.storage.formats.table import format_of, suffixes
from periscopy_sim.storage.photographs import read_photograph
from periscopy_sim.storage.pictures import area_average, linear_light, read_hidden_image


@dataclass(frozen=True, eq=False)
class Frames:
    """Photographs in time's order, each decoded and checked when it is read."""

    names: tuple[str, ...]  # the file or the number of each
    read: Callable[[int], Photograph]  # returns a frame by its number

    def __len__(self) -> int:
        return len(self.names)

    def __iter__(self) -> Iterator[Photograph]:
        return map(self.read, range(len(self)))


def open_frames(
    path: str | Path, shape: tuple[int, int], mask: NDArray[np.bool_] | None = None
) -> Frames:
    """Open a sequence of photographs; each is read and checked when its turn comes.

    A folder holds one photograph a file, of any format of `read_photograph` but one alone, in the
    natural order of their names: frame2 before frame10; other files and subfolders do not count. An
    array (frames, rows, columns, C) named `photograph` is in an NPZ file, which is decoded as a
    whole, or in a Zarr group of format 3, as a data set has it; an NPY file holds one, too.

    Parameters
    ----------
    path : Path
        The folder or file.
    shape : (rows, columns)
        Size that each photograph must have.
    mask : (rows, columns) bool
        Where the wall is used, see `read_photograph`; None: everywhere.

    Returns
    -------
    Frames
        At least one.

    Raises
    ------
    PhotographError
        Here if the sequence as a whole is missing, damaged, empty or of another form or size; while
        iterating as `read_photograph`, naming the frame, the first being 0.
    """
    path = Path(path)
    if path.is_dir() and not (path / "zarr.json").exists():
        files = files_of_one_kind(path)
        names = tuple(file.name for file in files)
        return Frames(names, lambda k: read_photograph(files[k], shape, mask))
    if path.is_dir():
        stack = zarr_stack(path, shape)
    elif open_stack := format_of(path).open_stack:
        stack = open_stack(path, shape)
    else:
        raise PhotographError(
            f"{path}: is a single {format_of(path).name} file; give a folder of photographs, a "
            "Zarr archive, or an NPY or NPZ stack"
        )
    check_size(_checked(stack, path).shape[1:3], shape, str(path))

    def read(k: int) -> Photograph:
        place = f"{path}, frame {k}"
        with decoding(place, "part of a stack"):
            values = np.asarray(stack[k])
        return Photograph.of(values, shape, place, mask=mask)

    return Frames(tuple(map(str, range(stack.shape[0]))), read)


def read_clip(sequence: Frames, progress: Callable[[float], None]) -> tuple[Array, list[str]]:
    """Read all photographs of a sequence, and the first warning of each kind, counted.

    The photographs are (frames, rows, columns, C), black where the mask leaves them out, as they
    are drawn. One that cannot serve is a `PhotographError` that names it.
    """
    of_kind: dict[str, list[str]] = {}
    frames = []
    for photograph in sequence:
        frames.append(blackened(photograph.values, photograph.mask))
        for warning in photograph.warnings:
            of_kind.setdefault(warning.partition(": ")[2], []).append(warning)
        progress(len(frames) / len(sequence))
    counted = (f"{w[0]} (likewise {len(w) - 1} more)" if w[1:] else w[0] for w in of_kind.values())
    return np.stack(frames), [*counted]


def read_hidden_frames(path: str | Path, shape: tuple[int, int], count: int) -> Iterator[Array]:
    """Yield what the hidden scene showed at each of `count` photographs: light, 1 for white.

    `path` is a folder of pictures of one format, in natural order, each read by
    `read_hidden_image`; an NPY stack (frames, any rows, any columns, 3) of linear light, its 8- or
    16-bit integers being fractions of their largest value; or one picture, which stands for every
    frame. Each is averaged over the area of each patch: (rows, columns, 3). Neither one frame nor
    `count` is a `PhotographError`.
    """
    path = Path(path)
    images: Iterator[Array]
    if path.is_dir():
        files = files_of_one_kind(path)
        number, images = len(files), (read_hidden_image(file, shape) for file in files)
    elif format_of(path).name == "NPY" and mapped_stack(path).ndim == 4:
        stack = _checked(mapped_stack(path), path)
        lights = (linear_light(each, f"{path}, frame {k}") for k, each in enumerate(stack))
        number, images = len(stack), (area_average(light, shape) for light in lights)
    else:
        number, images = 1, iter([read_hidden_image(path, shape)])
    if number not in (1, count):
        raise PhotographError(
            f"{path}: holds {number} hidden images for {count} photographs; give as many, or one"
        )
    return images if number == count else repeat(next(images), count)


def files_of_one_kind(folder: Path) -> list[Path]:
    """Return the pictures in a folder, known by their suffixes, in natural order.

    A folder with no picture, or with those of several formats, is a `PhotographError`.
    """
    known = suffixes()
    files = [each for each in folder.iterdir() if each.name[0] != "." and not each.is_dir()]
    of_kind: dict[str, list[Path]] = {}
    for file in sorted(files, key=lambda file: _natural(file.name)):
        if kind := known.get(file.suffix.lower()):
            of_kind.setdefault(kind, []).append(file)
    if len(of_kind) != 1:
        examples = listed([f"{kind} ({files[0].name})" for kind, files in of_kind.items()])
        raise PhotographError(
            f"{folder}: holds {examples or 'no picture'}; keep frames of one format alone there"
        )
    return next(iter(of_kind.values()))


def _natural(name: str) -> tuple[list[str | int], str]:
    """Return a sort key by which frame2 comes before frame10: text and numbers in turn."""
    pieces = re.split("([0-9]+)", name.lower())
    return [int(piece) if i % 2 else piece for i, piece in enumerate(pieces)], name


def _checked(stack: Any, path: Path) -> Any:
    """Return an array, mapped or in Zarr, if it is a stack of pictures."""
    check_real(stack.dtype, str(path))
    if len(stack.shape) != 4 or 0 in stack.shape:
        raise PhotographError(
            f"{path}: has shape {stack.shape}; give a stack (frames, rows, columns, channels)"
        )
    return stack
