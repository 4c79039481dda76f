"""Sequences of photographs, each decoded when its turn comes."""

from __future__ import annotations

import re
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from periscopy_sim.errors import PhotographError
from periscopy_sim.storage.decoding import file_format
from periscopy_sim.storage.photographs import Photograph, read_photograph

_KINDS = {
    ".exr": "EXR",
    ".npy": "NPY",
    ".npz": "NPZ",
    ".png": "PNG",
    ".tif": "TIFF",
    ".tiff": "TIFF",
    ".jpg": "JPEG",
    ".jpeg": "JPEG",
    ".mat": "MATLAB",
}
_ZARR_MARKS = ("zarr.json", ".zgroup", ".zarray")
_FORMS = "a folder of photographs, a Zarr archive, a multi-part EXR or an NPY or NPZ stack"


@dataclass(frozen=True, eq=False)
class Frames:
    """Photographs in time's order, decoded one at a time as they are iterated over.

    Attributes
    ----------
    names : tuple of str
        The file, the part or the number of each.
    warnings : tuple of str
        What was left out of the whole, one line each.
    decode : callable
        Starts an iterator over all of them.
    """

    names: tuple[str, ...]
    warnings: tuple[str, ...]
    decode: Callable[[], Iterator[Photograph]]

    def __len__(self) -> int:
        return len(self.names)

    def __iter__(self) -> Iterator[Photograph]:
        return self.decode()


def open_frames(
    path: str | Path, shape: tuple[int, int], mask: NDArray[np.bool_] | None = None
) -> Frames:
    """Open a sequence of photographs; each is read and checked when its turn comes.

    A folder holds one photograph a file, of any format of `read_photograph` but one alone, in the
    natural order of their names: frame2 before frame10. Hidden files and subfolders do not count;
    files of no such suffix are left out, with a warning. A Zarr archive, of format 2 or 3, is an
    array (frames, rows, columns, 3), or a group that has it as `photograph`. NPY and NPZ files (key
    `photograph`) hold such an array too. A multi-part EXR holds a frame in each part, as R, G, B or
    Y; OpenEXR decodes all its parts at once, so that it may be no larger than a still. Where there
    are three channels there may be one, which is grey.

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
    from periscopy_sim.storage.exr_frames import exr_frames
    from periscopy_sim.storage.stacks import npy_frames, npz_frames, zarr_frames

    path = Path(path)
    if path.is_dir():
        if any((path / mark).exists() for mark in _ZARR_MARKS):
            return zarr_frames(path, shape, mask)
        return _folder_frames(path, shape, mask)
    kind = file_format(path)
    if kind == "EXR":
        return exr_frames(path, shape, mask)
    if kind == "NPY":
        return npy_frames(path, shape, mask)
    if kind == "NPZ":
        return npz_frames(path, shape, mask)
    raise PhotographError(f"{path}: is a single {kind} file; give {_FORMS}")


def _folder_frames(path: Path, shape: tuple[int, int], mask: NDArray[np.bool_] | None) -> Frames:
    files, others = files_of_one_kind(path)
    warnings = (f"{path}: left out {listed(others)}",) if others else ()
    return Frames(
        tuple(file.name for file in files),
        warnings,
        lambda: (read_photograph(file, shape, mask) for file in files),
    )


def files_of_one_kind(folder: Path) -> tuple[list[Path], list[str]]:
    """List the pictures in a folder in natural order.

    Returns
    -------
    files : list of Path
        Those whose suffix is that of a picture; hidden files and subfolders do not count.
    others : list of str
        The names of the other files.

    Raises
    ------
    PhotographError
        If there is no picture, or pictures of several formats.
    """
    try:
        entries = [
            entry
            for entry in folder.iterdir()
            if not entry.name.startswith(".") and not entry.is_dir()
        ]
    except OSError as error:
        raise PhotographError(f"{folder}: cannot be opened: {error.strerror}") from error
    entries.sort(key=lambda entry: _natural(entry.name))
    of_kind: dict[str, list[Path]] = {}
    for entry in entries:
        of_kind.setdefault(_KINDS.get(entry.suffix.lower(), ""), []).append(entry)
    others = [entry.name for entry in of_kind.pop("", [])]
    if not of_kind:
        raise PhotographError(
            f"{folder}: holds no file named *{', *'.join(_KINDS)}; name a folder that does"
        )
    if len(of_kind) > 1:
        examples = listed([f"{kind} ({files[0].name})" for kind, files in of_kind.items()])
        raise PhotographError(f"{folder}: holds {examples}; keep frames of one format alone there")
    return next(iter(of_kind.values())), others


def _natural(name: str) -> tuple[list[str | int], str]:
    """Sort key by which frame2 comes before frame10: text and numbers in turn."""
    pieces = re.split("([0-9]+)", name.lower())
    return [int(piece) if i % 2 else piece for i, piece in enumerate(pieces)], name


def listed(names: Sequence[str]) -> str:
    """Join the first four names for a message, and tell how many follow."""
    rest = f" and {len(names) - 4} more" if len(names) > 4 else ""
    return ", ".join(names[:4]) + rest


def place_of(path: Path, frame: int | str) -> Path:
    """Name a frame of a file, or several, for a message."""
    return Path(f"{path}, frame {frame}")
