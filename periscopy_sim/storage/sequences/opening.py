"""Open a sequence of photographs, whichever form it has, and decode all of it."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from periscopy_sim.errors import PhotographError
from periscopy_sim.photograph import Photograph, blackened
from periscopy_sim.storage.formats.decoding import place_of
from periscopy_sim.storage.formats.table import format_of
from periscopy_sim.storage.sequences.folder import folder_frames
from periscopy_sim.storage.sequences.frames import Frames
from periscopy_sim.storage.sequences.stacks import mapped_stack, npy_writer, zarr_stack

_ZARR_MARKS = ("zarr.json", ".zgroup", ".zarray")
_FORMS = "a folder of photographs, a Zarr archive, a multi-part EXR or an NPY or NPZ stack"


def open_frames(
    path: str | Path, shape: tuple[int, int], mask: NDArray[np.bool_] | None = None
) -> Frames[Photograph]:
    """Open a sequence of photographs; each is read and checked when its turn comes.

    A folder holds one photograph a file, of any format of `read_photograph` but one alone, in the
    natural order of their names: frame2 before frame10. Hidden files and subfolders do not count;
    files of no such suffix are left out, with a warning. A Zarr archive, of format 2 or 3, is an
    array (frames, rows, columns, 3), or a group that has it as `photograph`. NPY and NPZ files (key
    `photograph`) hold such an array too. A multi-part EXR holds a frame in each part, of the
    channels that a still may have; OpenEXR decodes all its parts at once, so that it may be no
    larger than a still. Where there are three channels there may be one, which is grey.

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
    if path.is_dir() and not any((path / mark).exists() for mark in _ZARR_MARKS):
        return folder_frames(path, shape, mask)
    if path.is_dir():
        stack = zarr_stack(path, shape)
    else:
        row = format_of(path)
        if row.open_stack is None:
            raise PhotographError(f"{path}: is a single {row.name} file; give {_FORMS}")
        stack = row.open_stack(path, shape)

    def decode() -> Iterator[Photograph]:
        for k, values in enumerate(stack):
            yield Photograph.of(values, shape, str(place_of(path, k)), mask=mask)

    return Frames(stack.names, stack.warnings, decode)


def decoded_photographs(
    sequence: Frames[Photograph],
    shape: tuple[int, int],
    mask: NDArray[np.bool_] | None,
    file: Path,
    progress: Callable[[float], None],
) -> tuple[NDArray[np.floating[Any]], list[str]]:
    """Return all photographs of a sequence, and what was assumed or left out, once for each kind.

    They are (rows, columns, 3) each, black where the mask leaves them out, as they are drawn, and
    kept in an NPY file. One that cannot serve is a `PhotographError` that names it.
    """
    of_kind: dict[str, list[str]] = {}
    with npy_writer(file, (len(sequence), *shape, 3), np.float64) as write:
        for k, photograph in enumerate(sequence, 1):
            write(blackened(photograph.values, mask))
            for warning in photograph.warnings:
                of_kind.setdefault(warning.partition(": ")[2], []).append(warning)
            progress(k / len(sequence))
    counted = (
        first + (f" (likewise {len(others)} more)" if others else "")
        for first, *others in of_kind.values()
    )
    return mapped_stack(file), [*sequence.warnings, *counted]
