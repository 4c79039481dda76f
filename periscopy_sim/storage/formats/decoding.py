"""What decoders return, and every failure of a decoder as one error."""

import zlib
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from periscopy_sim.errors import PhotographError, path_fault
from periscopy_sim.numerics.limits import check_budget
from periscopy_sim.photograph import check_size

Size = tuple[int, int] | None
"""(rows, columns) that a picture must have, turned or not; None for any."""

LINEAR, SRGB, GAMMA = "linear", "sRGB", "gamma 1/2.2"
"""Encodings that a file may declare; converters write the last for linear light, too."""


@dataclass(frozen=True, eq=False)
class Picture:
    """What a file holds, as it was saved; row 0 is the top."""

    values: NDArray[Any]  # (rows, columns[, channels]) of any real dtype
    alpha: NDArray[Any] | None = None  # opacity, (rows, columns, 1) of that dtype
    left_out: tuple[str, ...] = ()  # other channels of the file
    unapplied: tuple[str, ...] = ()  # tags of corrections that the file asks for
    is_display: bool = False  # made for screens: integers may be encoded by the sRGB curve
    encoding: str | None = None  # what the file declares of its integers
    saturated: NDArray[np.bool_] | None = None  # (rows, columns), where its sensor says it was
    cell: int = 1  # pixels of the sensor along each side of one of these


def listed(names: Sequence[str]) -> str:
    """Return the first four names for a message, and the number of the others."""
    rest = f" and {len(names) - 4} more" if len(names) > 4 else ""
    return ", ".join(names[:4]) + rest


def check_head(shape: Sequence[int], size: Size, path: Path) -> None:
    """Reject pictures of another size, or too many values, before these are decoded.

    Four dimensions are those of a stack; the size of an array of any other number does not count.
    """
    rows_and_columns = tuple(shape[1:3] if len(shape) == 4 else shape[:2])
    if size is not None and len(shape) in (2, 3, 4) and {*rows_and_columns} != {*size}:
        check_size(rows_and_columns, size, str(path))
    check_budget(shape, path)


def check_inflated(packed: Any, most: int, wbits: int = zlib.MAX_WBITS) -> None:
    """Reject what zlib packed if it holds more bytes than its pixels take."""
    inflating = zlib.decompressobj(wbits)
    inflating.decompress(packed, most)
    if inflating.unconsumed_tail:
        raise ValueError("it holds more than its pixels")


@contextmanager
def decoding(path: str | Path, kind: str, remedy: str = "save or copy it again") -> Iterator[None]:
    """Raise whatever a decoder raises in the block as a `PhotographError`.

    The message names the file, the `kind` of its format, the reason and the `remedy`.
    """
    if fault := path_fault(path):
        raise PhotographError(f"{path}: {fault}")
    try:
        yield
    except PhotographError:
        raise
    except Exception as error:  # damaged bytes raise all kinds of exceptions
        text = getattr(error, "strerror", None) or str(error)
        reason = (text.splitlines() or [""])[0] or type(error).__name__
        raise PhotographError(f"{path}: cannot be read as {kind}: {reason}; {remedy}") from error
