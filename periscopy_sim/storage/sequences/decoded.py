"""Sequences decoded into one file that is mapped into memory, as long as they may be."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from periscopy_sim.photographs.checking import Photograph, blackened
from periscopy_sim.storage.sequences.frames import Frames
from periscopy_sim.storage.sequences.hidden_frames import read_hidden_frames
from periscopy_sim.storage.sequences.stacks import mapped_stack, npy_writer

Image = NDArray[np.floating[Any]]


def decoded_photographs(
    sequence: Frames[Photograph],
    shape: tuple[int, int],
    mask: NDArray[np.bool_] | None,
    file: Path,
    progress: Callable[[float], None],
) -> tuple[Image, list[str]]:
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


def decoded_truth(path: Path, shape: tuple[int, int], count: int, file: Path) -> Image:
    """Return what was hidden, (F, R, C, 3), frame by frame; see `read_hidden_frames`."""
    with npy_writer(file, (count, *shape, 3), np.float64) as write:
        for image in read_hidden_frames(path, shape, count):
            write(image)
    return mapped_stack(file)
