"""What the hidden scene showed while a sequence was photographed."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from itertools import repeat
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from periscopy_sim.errors import PhotographError
from periscopy_sim.photograph import check_real
from periscopy_sim.storage.formats.decoding import place_of
from periscopy_sim.storage.formats.table import format_of
from periscopy_sim.storage.pictures import area_average, linear_light, read_hidden_image
from periscopy_sim.storage.sequences.folder import files_of_one_kind
from periscopy_sim.storage.sequences.stacks import mapped_stack, npy_writer

Array = NDArray[np.float64]


def read_hidden_frames(path: str | Path, shape: tuple[int, int], count: int) -> Iterator[Array]:
    """Yield what the hidden scene showed at each of `count` photographs: light, 1 for white.

    `path` is a folder of pictures of one format, in natural order, each read by
    `read_hidden_image`; an NPY stack (frames, any rows, any columns, 3) of linear light, its 8- or
    16-bit integers being fractions of their largest value; or one picture, which stands for every
    frame. Each is averaged over the area of each patch: (rows, columns, 3). Neither one frame nor
    `count` is a `PhotographError`.
    """
    number, read = _opened(Path(path), shape)
    if number not in (1, count):
        raise PhotographError(
            f"{path}: holds {number} hidden images for {count} photographs; give as many, or one"
        )
    if number == count:
        yield from map(read, range(count))
    else:
        yield from repeat(read(0), count)


def decoded_truth(path: Path, shape: tuple[int, int], count: int, file: Path) -> NDArray[Any]:
    """Return what was hidden, (F, R, C, 3), frame by frame; see `read_hidden_frames`."""
    with npy_writer(file, (count, *shape, 3), np.float64) as write:
        for image in read_hidden_frames(path, shape, count):
            write(image)
    return mapped_stack(file)


def _opened(path: Path, shape: tuple[int, int]) -> tuple[int, Callable[[int], Array]]:
    """Return the number of frames, and what reads one."""
    if path.is_dir():
        files, _ = files_of_one_kind(path)
        return len(files), lambda k: read_hidden_image(files[k], shape)
    if format_of(path).name == "NPY":
        stack = mapped_stack(path)
        check_real(stack.dtype, str(path))
        if stack.ndim == 4:
            if stack.shape[-1] not in (1, 3) or 0 in stack.shape[1:]:
                raise PhotographError(
                    f"{path}: has frames of shape {stack.shape[1:]}; give (rows, columns, 3)"
                )

            def read(k: int) -> Array:
                return area_average(linear_light(stack[k], place_of(path, k)), shape)

            return len(stack), read
    image = read_hidden_image(path, shape)
    return 1, lambda _: image
