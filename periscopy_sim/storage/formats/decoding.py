"""What decoders return, bounds on what files announce, and every failure as one error."""

from __future__ import annotations

import io
import math
import os
import warnings
import zlib
from collections.abc import Iterable, Iterator, Sequence
from contextlib import ExitStack, contextmanager, redirect_stderr, redirect_stdout, suppress
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from periscopy_sim.errors import PhotographError

LARGEST_COUNT = 2**28
"""Most values (rows x columns x channels) that a file may announce."""

UNPACKED_COUNT = 2**25
"""Most values that a file may announce however small it is: few colours pack well."""

LARGEST_RATIO = 64
"""Most values that a larger file may announce for each of its bytes."""

_PIECE = 1 << 20  # bytes unpacked at once


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


def listed(names: Sequence[str]) -> str:
    """Return the first four names for a message, and how many follow."""
    rest = f" and {len(names) - 4} more" if len(names) > 4 else ""
    return ", ".join(names[:4]) + rest


def place_of(path: Path, frame: int | str) -> Path:
    """Return what to call a frame of a file, or several, in a message."""
    return Path(f"{path}, frame {frame}")


def check_count(shape: Sequence[int], path: Path) -> None:
    """Refuse a header that announces too many values, before allocating them.

    These are more than `LARGEST_COUNT`, or more than `UNPACKED_COUNT` and more than `LARGEST_RATIO`
    for each byte of the file. Nor may an extent be negative.
    """
    count, size = math.prod(shape), " x ".join(map(str, shape))
    if min(shape, default=1) < 0 or count > LARGEST_COUNT:
        raise PhotographError(
            f"{path}: its header announces {size} values, more than {LARGEST_COUNT}; "
            "the file is damaged, or average its pixels first"
        )
    if count > UNPACKED_COUNT and path.is_file() and count > LARGEST_RATIO * path.stat().st_size:
        raise PhotographError(
            f"{path}: its header announces {size} values, more than {LARGEST_RATIO} for each byte "
            "of the file; it is damaged, or average its pixels first"
        )


def check_unpacked(pieces: Iterable[bytes], most: int, path: Path) -> None:
    """Refuse deflated bytes that unpack to more than `most`; damaged ones are a zlib.error."""
    inflate, left = zlib.decompressobj(), most
    for packed in pieces:
        while packed:
            left -= len(inflate.decompress(packed, _PIECE))
            if left < 0:
                raise PhotographError(
                    f"{path}: unpacks to more pixels than its header announces; save or copy it "
                    "again"
                )
            packed = inflate.unconsumed_tail


@contextmanager
def decoding(path: Path, kind: str, remedy: str = "save or copy it again") -> Iterator[None]:
    """Read an untrusted file: quietly, and whatever the block raises becomes a `PhotographError`.

    Decoders meet damaged bytes with all kinds of exceptions. The message says the file, the `kind`
    of its format, and what a user can do about it.
    """
    try:
        with _silenced(), warnings.catch_warnings():
            warnings.simplefilter("ignore")
            yield
    except PhotographError:
        raise
    except Exception as error:
        reason = (str(error).splitlines() or [""])[0] or type(error).__name__
        raise PhotographError(f"{path}: cannot be read as {kind}: {reason}; {remedy}") from error


@contextmanager
def _silenced() -> Iterator[None]:
    """Keep decoders off the terminal: OpenEXR and libtiff print from C++ as well as Python."""
    with redirect_stdout(io.StringIO()), redirect_stderr(io.StringIO()), ExitStack() as restore:
        sink = os.open(os.devnull, os.O_WRONLY)
        restore.callback(os.close, sink)
        for descriptor in (1, 2):
            with suppress(OSError):  # a stream that was closed stays so
                saved = os.dup(descriptor)
                restore.callback(os.close, saved)
                restore.callback(os.dup2, saved, descriptor)
                os.dup2(sink, descriptor)
        yield
