"""What decoders return, and every failure of a decoder as one error."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Generic, TypeVar

import numpy as np
from numpy.typing import NDArray

from periscopy_sim.errors import PhotographError
from periscopy_sim.photograph import check_real, check_size

Frame = TypeVar("Frame")


@dataclass(frozen=True, eq=False)
class Picture:
    """What a file holds, as it was saved; row 0 is the top."""

    values: NDArray[Any]  # (rows, columns[, channels]) of any real dtype
    alpha: NDArray[Any] | None = None  # opacity, (rows, columns, 1) of that dtype
    left_out: tuple[str, ...] = ()  # other channels of the file
    is_display: bool = False  # made for screens: integers may be encoded by the sRGB curve
    profile: bytes = b""  # its ICC colour profile, if it has one
    exposure: float | None = None  # time, of raw sensor counts, which are averaged; else None
    saturated: NDArray[np.bool_] | None = None  # (rows, columns), where its sensor says it was
    cell: int = 1  # pixels of the sensor along each side of one of these


@dataclass(frozen=True, eq=False)
class Frames(Generic[Frame]):
    """Frames in time's order, decoded one at a time as they are iterated over.

    Attributes
    ----------
    names : tuple of str
        The file, the part or the number of each.
    warnings : tuple of str
        What was left out of the whole, one line each.
    decode : callable
        Starts an iterator over all of them: photographs, or arrays not yet checked one by one.
    """

    names: tuple[str, ...]
    warnings: tuple[str, ...]
    decode: Callable[[], Iterator[Frame]]

    def __len__(self) -> int:
        return len(self.names)

    def __iter__(self) -> Iterator[Frame]:
        return self.decode()


def listed(names: Sequence[str]) -> str:
    """Return the first four names for a message, and the number of the others."""
    rest = f" and {len(names) - 4} more" if len(names) > 4 else ""
    return ", ".join(names[:4]) + rest


def place_of(path: Path, frame: int | str) -> Path:
    """Return the name of a frame of a file, or of several, for a message."""
    return Path(f"{path}, frame {frame}")


def check_stack(
    shape: Sequence[int], dtype: np.dtype[Any], camera: tuple[int, int], path: Path
) -> None:
    """Check shape and dtype of a stack of photographs, (frames, rows, columns, 1 or 3)."""
    check_real(dtype, str(path))
    if len(shape) != 4 or shape[3] not in (1, 3) or shape[0] == 0:
        raise PhotographError(
            f"{path}: has shape {tuple(shape)}; give a stack (frames, rows, columns, 3)"
        )
    check_size(tuple(shape[1:3]), camera, str(path))


@contextmanager
def decoding(path: Path, kind: str, remedy: str = "save or copy it again") -> Iterator[None]:
    """Raise whatever a decoder raises in the block as a `PhotographError`.

    The message names the file, the `kind` of its format, the reason and the `remedy`.
    """
    try:
        yield
    except PhotographError:
        raise
    except Exception as error:  # damaged bytes raise all kinds of exceptions
        reason = (str(error).splitlines() or [""])[0] or type(error).__name__
        raise PhotographError(f"{path}: cannot be read as {kind}: {reason}; {remedy}") from error
